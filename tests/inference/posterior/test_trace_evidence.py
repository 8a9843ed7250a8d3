"""Log densities for cross-validation are the traces' own, whatever stands for the traces meanwhile."""

from __future__ import annotations

from pathlib import Path
from tomllib import loads
from typing import NamedTuple

import jax
import numpy as np
import pytest
from scipy.special import logsumexp, softmax

from bayestissue.hierarchy.specification import Sampler, read_specification
from bayestissue.hierarchy.trace_data import Prepared, prepare
from bayestissue.inference.factors.conditional import (
    ConditionalPrior,
    PopulationDraws,
    log_evidence,
    of_cells,
)
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    log_evidence_corrections,
    ratios_among,
)
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.factors.expansions import approximate
from bayestissue.inference.posterior.constrained_draws import constrained_draws
from bayestissue.inference.posterior.recipe import Problem, population_attempt, with_impacts
from bayestissue.inference.posterior.scores import LikelihoodApproximation, of_draws
from bayestissue.simulation import simulate
from bayestissue.simulation.specification import Simulation
from campaigns import FOUR_BY_FOUR

OTHERS = ("impact", "arma", "standard_linear")
MODELS = Path(__file__).parents[3] / "models"
# Few draws of a small campaign, and one population to look at.
SETTINGS, SEED = Sampler(chains=2, warmup=100, draws=100), 2
# Points of a normal about each impact's draws, twice as wide.
POINTS, WIDER = 2**14, 2.0


class Fit(NamedTuple):
    """A fit's draws of every impact's parameters, and the scores under one draw of the population."""

    prepared: Prepared
    likelihood: LikelihoodApproximation
    expected: PopulationDraws
    priors: ConditionalPrior
    ratios: ImportanceRatios
    u: np.ndarray
    draw: int
    scores: dict[str, np.ndarray]

    @property
    def prior(self) -> ConditionalPrior:
        """Of every impact under that draw."""
        return ConditionalPrior(self.priors.mean[self.draw], self.priors.precision[self.draw, 0])


def small_campaign() -> Simulation:
    """Two people in two conditions, twice each, on springs and dampers."""
    conditions = [{"trial": f"m{mass}", "mass_kg": mass, "velocity_m_s": 1.2} for mass in (0.5, 1.0)]
    return Simulation.model_validate(
        {
            "name": "small",
            "seed": SEED,
            "design": {"subjects": 2, "conditions": conditions, "repeats": 2},
            "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, "sd_subject_K": 0.2, "sd_impact_K": 0.05},
            "recording": {
                "sampling_rate_hz": 5000.0,
                "before_contact_s": 0.005,
                "noise_relative_to_peak": 0.005,
            },
        }
    )


@pytest.fixture(
    scope="module",
    # By default of the campaign that other tests fit too, so that little is compiled; all in the long suite.
    params=["a2", *(pytest.param(name, marks=pytest.mark.long) for name in OTHERS)],
)
def fit(request: pytest.FixtureRequest) -> Fit:
    """With every parameter in the summary, and with a last one that has a profile."""
    specification = read_specification(MODELS / f"{request.param}.toml")
    campaign = small_campaign() if request.param in OTHERS else Simulation.model_validate(loads(FOUR_BY_FOUR))
    prepared = prepare(simulate(campaign).dataset("small"), specification, source="model")
    # The first kind of sites alone: the scores are those of any, and other kinds might be the better ones.
    approximation = approximate(prepared)
    problem = Problem(prepared, SETTINGS, SEED, np.random.default_rng(SEED))
    made = population_attempt(problem, approximation)
    draws, expected = with_impacts(problem, made), made.draws
    assert (approximation.grid is None) == (request.param in ("a2", "impact"))
    likelihood = LikelihoodApproximation(approximation)
    design = prepared.data.design
    priors = of_cells(expected.priors(design), np.asarray(design.cell))
    ratios = ratios_among(prepared.model, prepared.data, approximation.sites, priors, approximation.grid)
    found = constrained_draws(prepared, approximation, draws, jax.random.PRNGKey(0), likelihood=likelihood)
    u = found.impacts["parameters"]
    scores = of_draws(prepared, likelihood, expected)
    for name, values in found.log_likelihood.items():
        np.testing.assert_array_equal(values.reshape(scores[name].shape), scores[name])
    # What is known already is not found again.
    corrections = log_evidence_corrections(approximation.sites, ratios, priors)
    again = of_draws(prepared, likelihood._replace(corrections=corrections), expected)
    for name, values in scores.items():
        np.testing.assert_allclose(again[name], values, rtol=1e-9)
    # One of the fiftieth of all draws under which summaries alone say least of the traces.
    off = np.abs((log_evidence(approximation.sites, priors) - scores["trace"]).sum(-1))
    draw = int(np.argsort(off)[-len(off) // 50])
    own = {name: values[draw] for name, values in scores.items()}
    return Fit(prepared, likelihood, expected, priors, ratios, u.reshape(-1, *u.shape[2:]), draw, own)


def log_mean(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log of the mean of weights along the first axis, and its standard error."""
    total = logsumexp(weight, axis=0)
    share = np.exp(weight - total)
    return total - np.log(len(weight)), np.sqrt(np.square(share - 1 / len(weight)).sum(0))


def test_an_impacts_density_is_its_likelihood_integrated_over_the_population(fit: Fit) -> None:
    """Without any summary: points about each impact's draws, each weighed by likelihood and population."""
    anchor, middle = fit.prior, fit.u.mean(0)
    root = WIDER * np.linalg.cholesky(np.stack([np.cov(each.T) for each in fit.u.swapaxes(0, 1)]))
    z = np.random.default_rng(1).standard_normal((POINTS, *middle.shape))
    points = middle + np.matvec(root, z)
    log_proposal = -np.square(z).sum(-1) / 2 - np.log(np.diagonal(root, axis1=1, axis2=2)).sum(-1)
    away, half_log = points - anchor.mean, np.linalg.slogdet(anchor.precision)[1] / 2
    log_population = half_log - (away * np.matvec(anchor.precision, away)).sum(-1) / 2
    likelihood = log_likelihoods(fit.prepared.model, fit.prepared.data, points)
    direct, error = log_mean(likelihood + log_population - log_proposal)
    # Of these points and of those that traces and summaries were compared at, which count by what the summary
    # and this draw of the population make of them, over how dense they lie; with a grid all alike.
    dense = np.zeros(fit.ratios.log_ratio.shape)
    if fit.likelihood.approximation.grid is None:
        u = np.asarray(fit.ratios.u)
        away = u - anchor.mean
        dense = fit.likelihood.approximation.sites.log_density(u) - fit.ratios.log_density
        dense = dense - (away * np.matvec(anchor.precision, away)).sum(-1) / 2
    share = softmax(dense, axis=0)
    ratio = np.exp(np.asarray(fit.ratios.log_ratio))
    middle = (share * ratio).sum(0)
    error = np.hypot(error, np.sqrt(np.square(share * (ratio - middle)).sum(0)) / middle)
    assert (np.abs(fit.scores["trace"] - direct) < 5 * error).all()
    if fit.likelihood.approximation.grid is not None:
        # The summaries alone, which know nothing of the last parameter, are off by more than that.
        alone = log_evidence(fit.likelihood.approximation.sites, anchor)
        assert np.abs((alone - direct).sum()) > 5 * np.sqrt(np.square(error).sum())


@pytest.mark.parametrize("group", ["subject", "trial"])
def test_a_groups_density_is_that_of_its_impacts_integrated_over_its_effects(fit: Fit, group: str) -> None:
    design, parts = fit.prepared.design, fit.prepared.model.locations.parts
    codes, count = getattr(design, group), len(getattr(design, f"{group}s"))
    places = [parts[f"{group}_effect_{q}"] for q in ("K", "C")]
    effects = np.stack([fit.expected.b[:, place] for place in places], axis=-1)
    sd = np.array([fit.expected.sites[f"sd_{group}_{q}"][fit.draw] for q in ("K", "C")])
    anchor = fit.prior
    start = anchor.mean.copy()
    start[:, :2] -= effects[fit.draw, codes]
    # Effects given their own impacts alone lie where those say, which all draws agree on better than this.
    middle = effects[fit.draw]
    scale = WIDER * np.minimum(effects.std(0), sd)
    z = np.random.default_rng(2).standard_normal((1024, count, 2))
    moved = middle + scale * z
    log_weight = -np.square(moved / sd).sum(-1) / 2 - np.log(sd).sum()
    log_weight += np.square(z).sum(-1) / 2 + np.log(scale).sum(-1)
    mean = np.repeat(start[None], len(z), axis=0)
    mean[..., :2] += moved[:, codes]
    anchors = ConditionalPrior(mean, np.repeat(anchor.precision[None, None], len(z), axis=0))
    besides = factors(fit, anchors)
    member = (codes[:, None] == np.arange(count)).astype(float)
    density = (log_evidence(fit.likelihood.approximation.sites, anchors) + besides) @ member + log_weight
    direct, error = log_mean(density)
    # The factors besides the summaries are taken at the draw's own effects, and move about so much.
    share = np.exp(density - logsumexp(density, axis=0))
    total = besides @ member
    scatter = np.sqrt((share * np.square(total - (share * total).sum(0))).sum(0))
    assert (np.abs(fit.scores[f"traces_of_{group}"] - direct) < 5 * np.hypot(error, scatter)).all()


def test_an_impact_without_a_density_takes_only_its_own_groups(fit: Fit) -> None:
    corrections = np.zeros((len(fit.expected.b), len(fit.prepared.impacts)))
    whole = of_draws(fit.prepared, fit.likelihood._replace(corrections=corrections), fit.expected)
    corrections[:, 0] = -np.inf
    without = of_draws(fit.prepared, fit.likelihood._replace(corrections=corrections), fit.expected)
    own = fit.prepared.design.groupings["subject"].code[0]
    expected = whole["traces_of_subject"].copy()
    expected[:, own] = -np.inf
    np.testing.assert_array_equal(without["traces_of_subject"], expected)


def factors(fit: Fit, anchors: ConditionalPrior) -> np.ndarray:
    """What each trace's likelihood has besides its summary."""
    found = log_evidence_corrections(fit.likelihood.approximation.sites, fit.ratios, anchors)
    if fit.likelihood.approximation.grid is None:
        return found
    sd = anchors.precision[0, 0, -1, -1] ** -0.5
    return found + np.stack(
        [fit.likelihood.approximation.grid.log_evidence(mean, sd) for mean in anchors.mean[..., -1]]
    )
