from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from bayestissue import runtime
from bayestissue.dataset.published import read_published
from bayestissue.hierarchy.effects import design_arrays
from bayestissue.hierarchy.published import observed_arrays, published_design, published_observations
from bayestissue.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.inference import published
from bayestissue.inference.samplers.sampling import PosteriorSampler
from bayestissue.likelihood.averages import average_statistics

TRUTH = {"mass_exponent_K": 0.4, "mass_exponent_C": 1.2, "intercept_K": 3.0, "intercept_C": 0.5}
SPECIFICATION = ModelSpecification(
    name="small",
    likelihood="published-estimates",
    sampler=Sampler(chains=2, warmup=150, draws=200, target_accept=0.8, max_tree_depth=7),
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
def sampler(campaign):
    return PosteriorSampler(published._model(campaign[1], SPECIFICATION), SPECIFICATION.sampler)


@pytest.fixture(scope="module")
def arguments(campaign):
    return design_arrays(campaign[1], 0), observed_arrays(campaign[0])


@pytest.fixture(scope="module")
def draws(sampler, arguments):
    return sampler.run(3, [arguments])[0]


def test_known_parameters_are_recovered(draws) -> None:
    for name, value in TRUTH.items():
        sampled = draws.sites[name]
        # Four posterior standard deviations: one data set in ten thousand would miss.
        assert abs(sampled.mean() - value) < 4 * sampled.std(), name
    # And the data must have said something: the priors' standard deviations are 1 and 3.
    assert draws.sites["mass_exponent_K"].std() < 0.3


def test_the_same_seed_gives_the_same_draws_on_any_number_of_threads(
    sampler, arguments, draws, monkeypatch
) -> None:
    monkeypatch.setattr(runtime, "cores", lambda: 1)
    again = sampler.run(3, [arguments])[0]
    for name, values in draws.sites.items():
        assert_array_equal(values, again.sites[name], err_msg=name)
    other = sampler.run(4, [arguments])[0]
    assert not np.array_equal(other.sites["intercept_K"], draws.sites["intercept_K"])
    assert not np.array_equal(draws.sites["intercept_K"][0], draws.sites["intercept_K"][1])


def test_the_log_likelihood_of_each_estimate_by_hand(campaign, draws) -> None:
    observations, design = campaign
    estimates, _ = published._distributions(design, observations, draws.sites)
    ours = np.asarray(estimates.log_prob(observations.log_estimates))[1, 7]
    at = {name: values[1, 7] for name, values in draws.sites.items()}
    sd_K, sd_C, r = at["sd_impact_K"], at["sd_impact_C"], at["residual_correlation"]
    covariance = [[sd_K**2, r * sd_K * sd_C], [r * sd_K * sd_C, sd_C**2]]
    for row, cell in enumerate(observations.impact_cell):
        subject, trial = design.subject[cell], design.trial[cell]
        log_mass = np.log(observations.cells["mass_kg"][cell] / design.reference_mass_kg)
        mean = [
            at[f"intercept_{q}"]
            + at[f"mass_exponent_{q}"] * log_mass
            + at[f"subject_effect_{q}"][subject]
            + at[f"trial_effect_{q}"][trial]
            for q in "KC"
        ]
        # A few roundings of numbers of order 10.
        direct = multivariate_normal(mean, covariance).logpdf(observations.log_estimates[row])
        assert_allclose(ours[row], direct, rtol=1e-10, atol=1e-10)
