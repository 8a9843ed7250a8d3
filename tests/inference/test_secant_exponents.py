"""Mass exponents of the force over depth, from draws of the impacts and of the population."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bayestissue.hierarchy.design import Design, ResponseDesign
from bayestissue.hierarchy.half_normal import HalfNormalSpread
from bayestissue.hierarchy.priors import Normal
from bayestissue.inference.secant_exponents import _GRID, exponent_of_levels, mass_exponents_of_secants
from bayestissue.inference.trace_draws import Unfolded

PEOPLE, CONDITIONS, DRAWS = 3, 8, 4000
LOG_MASS = np.linspace(-0.6, 0.6, CONDITIONS)
PRIOR = Normal(distribution="normal", mean=0.5, sd=1.0)
SCALE = 0.5


def prepared(groups: tuple[str, ...] = ("subject", "trial")) -> Any:
    subject, trial = (each.ravel() for each in np.mgrid[:PEOPLE, :CONDITIONS])
    none = np.zeros((len(subject), 0))
    part = ResponseDesign((), none, np.ones(0), LOG_MASS[trial], groups)
    names = tuple(map(str, range(PEOPLE))), tuple(map(str, range(CONDITIONS)))
    priors = SimpleNamespace(mass_exponent=SimpleNamespace(K=PRIOR))
    model = SimpleNamespace(priors=priors, prior_of=lambda name: HalfNormalSpread(SCALE))
    return SimpleNamespace(design=Design({"K": part, "C": part}, subject, trial, *names, 0.7), model=model)


def unfolded(at: Any, levels: np.ndarray, common: np.ndarray, secant: np.ndarray) -> Unfolded:
    """Draws, all alike, of a K whose conditions have these levels of its log; and what lies above log K."""
    design, shape = at.design, (2, DRAWS // 2)
    slope = float(stats.linregress(LOG_MASS, levels).slope)
    sites = {
        "intercept_K": np.full(shape, levels.mean()),
        "mass_exponent_K": np.full(shape, slope),
        "subject_effect_K": np.zeros((*shape, PEOPLE)),
        "trial_effect_K": np.broadcast_to(levels - levels.mean() - slope * LOG_MASS, (*shape, CONDITIONS)),
    }
    K = np.broadcast_to(np.exp(levels[design.trial]), (*shape, len(design.trial)))
    impacts = {"K": K, "K_common_depth": K * np.exp(common), "K_secant": K * np.exp(secant)}
    return Unfolded(sites, impacts, {})


def density(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The exponent's posterior by brute force: a grid of it, and its distribution."""
    b, s = np.linspace(-2, 2, 4001), np.geomspace(1e-3, 5, 800)
    centred = levels - levels.mean()
    m = LOG_MASS - LOG_MASS.mean()
    residual = ((centred[:, None] - b * m[:, None]) ** 2).sum(0)
    # The intercept's flat prior takes one of the eight powers of s, the grid's even steps in log s give one.
    log = stats.halfnorm(scale=SCALE).logpdf(s) - (len(m) - 2) * np.log(s) - residual[:, None] / (2 * s**2)
    joint = np.exp(log - log.max()).sum(1) * stats.norm(PRIOR.mean, PRIOR.sd).pdf(b)
    return b, np.cumsum(joint) / joint.sum()


def assert_distributed(draws: np.ndarray, levels: np.ndarray) -> None:
    b, below = density(levels)
    # Kolmogorov's statistic of independent draws exceeds this once in ten thousand times.
    distance = np.abs(
        np.interp(np.sort(draws.ravel()), b, below) - (np.arange(draws.size) + 0.5) / draws.size
    )
    assert distance.max() < 2.23 / np.sqrt(draws.size)


def test_an_exponent_given_levels_has_its_exact_posterior() -> None:
    levels = np.random.default_rng(1).normal(7.0, 0.1, CONDITIONS) + 0.2 * LOG_MASS
    prior = np.asarray(HalfNormalSpread(SCALE).log_prob(_GRID))
    given = np.broadcast_to(levels, (2, DRAWS // 2, CONDITIONS))
    draws = exponent_of_levels(given, LOG_MASS, (PRIOR.mean, PRIOR.sd), prior, np.random.default_rng(2))
    assert draws.shape == (2, DRAWS // 2)
    assert_distributed(draws, levels)


@pytest.mark.parametrize("groups", [("subject", "trial"), ("subject",)])
def test_the_scatter_of_conditions_is_that_at_the_depth(groups: tuple[str, ...]) -> None:
    """Conditions that differ by 0.1 at one depth and half as much at the greatest, where mass counts too."""
    at = prepared(groups)
    effects = np.random.default_rng(3).normal(0, 0.1, CONDITIONS)
    own, common = 7 + effects / 2 + 0.3 * LOG_MASS, 7 + effects
    trial = at.design.trial
    made = unfolded(at, own, (common - own)[trial], np.zeros(len(trial)))
    found = mass_exponents_of_secants(at, made, 0)
    if groups == ("subject", "trial"):
        assert_distributed(found["mass_exponent_K_common_depth"], common)
        assert_distributed(found["mass_exponent_K_secant"], own)
    widths = [np.ptp(np.quantile(values, [0.05, 0.95])) for values in found.values()]
    # Twice as wide but for the priors, which take a little off the wider; three standard errors of 2 %.
    assert 1.7 < widths[0] / widths[1] < 2 * 1.06
    middle = [float(np.median(values)) for values in found.values()]
    assert middle[1] - 0.3 == pytest.approx(middle[0] / 2, abs=0.02)


def test_k_that_is_the_secant_keeps_its_exponent_and_k_without_mass_has_none() -> None:
    at = prepared()
    made = unfolded(at, 7 + 0.3 * LOG_MASS, *np.zeros((2, PEOPLE * CONDITIONS)))
    made.impacts["K"] = made.impacts["K_secant"]
    found = mass_exponents_of_secants(at, made, 0)
    np.testing.assert_array_equal(found["mass_exponent_K_secant"], made.sites["mass_exponent_K"])
    del made.impacts["K_common_depth"]
    assert mass_exponents_of_secants(at, made, 0) == {}
