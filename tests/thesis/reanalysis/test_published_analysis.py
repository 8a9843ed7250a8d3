from __future__ import annotations

from dataclasses import replace

import arviz as az
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.infer import MCMC, NUTS

from bayestissue.model.hierarchy.derived import effects_by_name
from bayestissue.model.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.recordings.dataset.published import read_published
from bayestissue.thesis.reanalysis import competing_explanations
from bayestissue.thesis.reanalysis.competing_explanations import log_predictive_density
from bayestissue.thesis.reanalysis.observations import (
    average_statistics,
    published_design,
    published_observations,
)
from bayestissue.thesis.reanalysis.table_chain import sample_posterior
from bayestissue.thesis.reanalysis.table_model import (
    EstimatesModel,
    common_effects,
    estimates_data,
)
from published_model import plain_model

pytestmark = pytest.mark.slow

TRUTH = {"mass_exponent_K": 0.4, "mass_exponent_C": 1.2, "intercept_K": 3.0, "intercept_C": 0.5}
SPECIFICATION = ModelSpecification(
    name="small",
    likelihood="published-estimates",
    sampler=Sampler(chains=2, draws=1000),
)


@pytest.fixture(scope="module")
def campaign():
    """Ten people in the published nine conditions, made from `TRUTH`; two conditions left as averages."""
    observations = published_observations(read_published())
    design = published_design(observations, SPECIFICATION)
    rng = np.random.default_rng(17)
    people, trials = 0.15 * rng.standard_normal((10, 2)), 0.1 * rng.standard_normal((9, 2))
    scatter = rng.multivariate_normal([0, 0], [[0.04, -0.03], [-0.03, 0.09]], len(design.subject))
    logs = (
        np.array([TRUTH["intercept_K"], TRUTH["intercept_C"]])
        + np.outer(design.responses["K"].log_mass, [TRUTH["mass_exponent_K"], TRUTH["mass_exponent_C"]])
        + people[design.subject]
        + trials[design.trial]
        + scatter
    )
    lost = np.exp(logs[observations.averaged_cells])
    averages = average_statistics(jnp.asarray(lost.mean(1)), jnp.asarray(lost.std(1, ddof=1)))
    made = replace(
        observations,
        log_estimates=logs[observations.impact_cell],
        averages=np.concatenate([np.asarray(part) for part in averages], axis=1),
    )
    return made, design


@pytest.fixture(scope="module")
def problem(campaign):
    observations, design = campaign
    model = EstimatesModel(common_effects([design], SPECIFICATION.priors), SPECIFICATION.priors, True)
    return model, estimates_data(design, observations, model)


@pytest.fixture(scope="module")
def found(problem):
    return sample_posterior(*problem, SPECIFICATION.sampler, 3)


@pytest.fixture(scope="module")
def population(campaign, problem, found):
    return found.hyperparameters | effects_by_name(problem[0].locations, campaign[1], found.b)


@pytest.mark.slow
def test_known_parameters_are_recovered(population) -> None:
    for name, value in TRUTH.items():
        # Four posterior standard deviations: one data set in ten thousand would miss.
        assert abs(population[name].mean() - value) < 4 * population[name].std(), name
    # And the data must have said something: the priors' standard deviations are 1 and 3.
    assert population["mass_exponent_K"].std() < 0.3


def test_the_tables_sites_stand_for_their_factors(found) -> None:
    assert found.verdict.passed
    assert found.acceptance > 0.7


@pytest.mark.slow
def test_a_trial_is_scored_alike_with_it_and_without_it(campaign, problem, found, monkeypatch) -> None:
    """Importance sampling of the posterior that has a trial, and chains that do not, estimate one number."""
    observations, design = campaign
    trial = np.r_[design.trial[observations.averaged_cells[:, 0]], design.trial[observations.impact_cell]]
    rows, settings = trial == trial[-1], SPECIFICATION.sampler
    by_weights = log_predictive_density(problem[0], found, rows, settings=settings, seed=0)
    monkeypatch.setattr(competing_explanations, "k_threshold", lambda _: -np.inf)
    refitted = log_predictive_density(problem[0], found, rows, settings=settings, seed=0)
    # Both have some two hundred independent draws, over which the density varies by about its size.
    assert abs(by_weights - refitted) < 4 * np.sqrt(2 / 200)


@pytest.mark.long
def test_the_chain_agrees_with_trajectories_over_the_plain_model(campaign, problem) -> None:
    """The referee: the No-U-Turn sampler on the model from the top down."""
    model, data = problem
    settings = SPECIFICATION.sampler.model_copy(update={"draws": 1000, "effective": 1000, "chains": 4})
    found = sample_posterior(model, data, settings, 0)
    kernel = NUTS(plain_model, target_accept_prob=0.95, dense_mass=True)
    chains = MCMC(kernel, num_warmup=1500, num_samples=4000, num_chains=4, chain_method="sequential")
    chains.run(jax.random.key(0), model, data)
    referee = chains.get_samples(group_by_chain=True)
    ours = found.hyperparameters | {"b": found.b[..., [0, 1]]}
    theirs = {name: np.asarray(referee[name]) for name in model.hyperparameters}
    theirs["b"] = np.asarray(referee["locations"])[..., [0, 1]]
    for name, values in ours.items():
        own, other = (az.convert_to_dataset({"x": each[name]})["x"] for each in (ours, theirs))
        for statistic in (lambda x: x.mean(("chain", "draw")), lambda x: x.quantile(0.95, ("chain", "draw"))):
            size = [az.ess(each.to_dataset(), method="tail")["x"] for each in (own, other)]
            # Of a 95 % quantile the standard error is about twice that of a mean.
            error = 2.1 * values.std((0, 1)) * np.sqrt(sum(1 / each.to_numpy() for each in size))
            assert (np.abs((statistic(own) - statistic(other)).to_numpy()) < 4 * error).all(), name
