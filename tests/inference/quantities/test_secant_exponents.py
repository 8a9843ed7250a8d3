"""Mass exponents of the force over depth, from draws of the impacts and of the population."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.inference.quantities.secants import (
    _SPREADS,
    Units,
    mass_exponents_of_secants,
    slope_over_units,
    units_of,
)
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.priors import Normal
from bayestissue.model.hierarchy.specification import Formulas
from bayestissue.model.hierarchy.trace_models import HalfNormalSpread

PEOPLE, CONDITIONS, DRAWS = 3, 8, 4000
SHAPE = (2, DRAWS // 2)
LOG_MASS = np.linspace(-0.6, 0.6, CONDITIONS)
SCALE = 0.5
LOG_PRIOR = stats.halfnorm(scale=SCALE).logpdf(_SPREADS)
WIDE = (0.5, 100.0)
EPSILON = np.finfo(float).eps


NOTHING = np.zeros((CONDITIONS, 0))


def prepared(groups: tuple[str, ...] = ("subject", "trial"), *, discrepancy: bool = False) -> Any:
    subject, trial = (each.ravel() for each in np.mgrid[:PEOPLE, :CONDITIONS])
    rows = pd.DataFrame({"subject": subject, "trial": trial, "mass_kg": 0.7 * np.exp(LOG_MASS[trial])})
    formula = " + ".join(["log(mass_kg)", *(f"(1|{group})" for group in groups)])
    design = build_design(
        Formulas(K=formula, C=formula), rows, reference_mass_kg=0.7, source="the model file"
    )
    prior = Normal(distribution="normal", mean=WIDE[0], sd=WIDE[1])
    priors = SimpleNamespace(mass_exponent=SimpleNamespace(K=prior))
    model = SimpleNamespace(priors=priors, prior_of=lambda name: HalfNormalSpread(SCALE))
    model.discrepancy = discrepancy
    return SimpleNamespace(design=design, model=model)


def constrained(at: Any, K: np.ndarray, common: np.ndarray, secant: np.ndarray) -> Draws:
    """Draws with these logs of the impacts' stiffnesses, of conditions whose exponent is drawn about 0.3."""
    exponent = 0.3 + 0.1 * np.random.default_rng(5).standard_normal(SHAPE)
    population = {
        "intercept_K": np.full(SHAPE, 7.0),
        "mass_exponent_K": exponent,
        "subject_effect_K": np.zeros((*SHAPE, PEOPLE)),
        "trial_effect_K": np.zeros((*SHAPE, CONDITIONS)),
    }
    logs = {"K": K, "K_common_depth": common, "K_secant": secant}
    count = len(at.design.trial)
    return Draws(population, {n: np.broadcast_to(np.exp(v), (*SHAPE, count)) for n, v in logs.items()}, {})


def assert_distributed(draws: np.ndarray, levels: np.ndarray, variance: float = 0.0) -> None:
    """As b is of levels with noise of this variance, by sums over a fine grid of the spread."""
    m, s = LOG_MASS - LOG_MASS.mean(), np.geomspace(1e-3, 10, 2001)
    slope = levels @ m / (m @ m)
    left = levels - levels.mean() - slope * m
    # Two of the eight powers go with the intercept and the slope; the grid's steps in log s give one.
    whole = s**2 + variance
    log = stats.halfnorm(scale=SCALE).logpdf(s) + np.log(s)
    log -= (len(m) - 2) / 2 * np.log(whole) + left @ left / (2 * whole)
    weight = np.exp(log - log.max())
    b = np.linspace(slope - 3, slope + 3, 1201)
    spread = np.sqrt(whole / (m @ m))
    below = (weight / weight.sum()) @ stats.norm.cdf(b, slope, spread[:, None])
    share = (np.arange(draws.size) + 0.5) / draws.size
    distance = np.abs(np.interp(np.sort(draws.ravel()), b, below) - share)
    # Kolmogorov's statistic of independent draws exceeds this once in ten thousand times.
    assert distance.max() < 2.23 / np.sqrt(draws.size)


def test_what_draws_leave_open_of_the_units_is_not_taken_for_their_scatter() -> None:
    random, sd = np.random.default_rng(3), 0.15
    levels = random.normal(7.0, 0.15, CONDITIONS)
    noise = random.standard_normal((*SHAPE, CONDITIONS))
    noise = (noise - noise.mean((0, 1))) / noise.std((0, 1)) * sd
    units = Units("trial", LOG_MASS, levels + noise, NOTHING)
    draws = slope_over_units(units, WIDE, LOG_PRIOR, random)
    assert_distributed(draws, levels, sd**2)


def test_two_units_leave_their_scatter_to_its_prior() -> None:
    levels = np.broadcast_to([7.0, 7.2], (*SHAPE, 2))
    units = Units("trial", np.array([-0.5, 0.5]), levels, np.zeros((2, 0)))
    draws = slope_over_units(units, WIDE, LOG_PRIOR, np.random.default_rng(4))
    # The standard deviation of the sum of squares over 4000 draws of a normal with half-normal spread.
    assert np.mean((draws - 0.2) ** 2) == pytest.approx(SCALE**2 / 0.5, rel=4 * np.sqrt(8 / DRAWS))


def test_without_a_discrepancy_the_law_s_slope_is_added_to_the_exponent_of_k() -> None:
    at = prepared()
    log_mass = at.design.responses["K"].log_mass
    own = 7 + 0.3 * log_mass
    found = mass_exponents_of_secants(at, constrained(at, own, own + 1.0, own + 0.2 * log_mass), 0)
    exponent = constrained(at, own, own, own).population["mass_exponent_K"]
    np.testing.assert_allclose(found["mass_exponent_K_common_depth"], exponent, rtol=0, atol=200 * EPSILON)
    np.testing.assert_allclose(found["mass_exponent_K_secant"], exponent + 0.2, rtol=0, atol=200 * EPSILON)


def test_stiffness_that_a_draw_has_below_nothing_has_no_exponent() -> None:
    at = prepared(discrepancy=True)
    made = constrained(at, *np.zeros((3, PEOPLE * CONDITIONS)))
    made.impacts["K_common_depth"] = made.impacts["K_common_depth"].copy()
    made.impacts["K_common_depth"][0, 0, 0] = -1.0
    assert list(mass_exponents_of_secants(at, made, 0)) == ["mass_exponent_K_secant"]


def test_units_are_what_mass_varies_between() -> None:
    logs = np.random.default_rng(6).normal(size=(*SHAPE, PEOPLE * CONDITIONS))
    at = prepared()
    person = np.array([0.0, 3.0, -1.0])
    # Of a person who was not hit in every condition, the other conditions' means would be moved.
    which = np.arange(PEOPLE * CONDITIONS)[3:]
    rows = pd.DataFrame({"subject": at.design.subject, "trial": at.design.trial})
    mass = {"mass_kg": 0.7 * np.exp(LOG_MASS[at.design.trial])}
    some = build_design(Formulas(), rows.assign(**mass).iloc[which], reference_mass_kg=0.7, source="")
    trial = np.arange(CONDITIONS) * 0.1
    made = np.broadcast_to(trial[some.trial] + person[some.subject], (*SHAPE, len(which)))
    found = units_of(some, made)
    np.testing.assert_allclose(found.levels - found.levels[..., :1], trial + 0 * found.levels, atol=1e-12)
    found = units_of(at.design, logs + person[at.design.subject])
    np.testing.assert_allclose(found.log_mass, LOG_MASS, atol=4 * EPSILON)
    mean = (logs + person[at.design.subject]).reshape(*SHAPE, PEOPLE, CONDITIONS).mean(2)
    np.testing.assert_allclose(found.levels, mean, atol=1000 * EPSILON)
    alone = units_of(prepared(("subject",)).design, logs)
    assert (found.name, alone.name) == ("trial", "impact")
    np.testing.assert_array_equal(alone.levels, logs)


def test_impacts_as_units_have_the_slope_that_least_squares_has_within_people() -> None:
    """Of impacts that lie off their people's lines by a normal of this spread, by the textbook's formula."""
    at, random = prepared(("subject",)).design, np.random.default_rng(7)
    subject, m = at.subject, at.responses["K"].log_mass
    assert m is not None
    y = 0.3 * m + np.array([0.0, 2.0, -1.0])[subject] + random.normal(0, 0.1, len(m))
    units = units_of(at, np.broadcast_to(y, (*SHAPE, len(m))))
    of_one = np.where(np.abs(_SPREADS - 0.1) == np.abs(_SPREADS - 0.1).min(), 0.0, -np.inf)
    draws = slope_over_units(units, WIDE, of_one, random)
    matrix = np.column_stack([m, subject[:, None] == np.arange(PEOPLE)])
    slope = np.linalg.lstsq(matrix, y)[0][0]
    sd = 0.1 * np.sqrt(np.linalg.inv(matrix.T @ matrix)[0, 0])
    # Mean and standard deviation of 4000 normal draws; the grid's spread is within 1.2 % of 0.1.
    assert draws.mean() == pytest.approx(slope, abs=4 * sd / np.sqrt(DRAWS))
    assert draws.std() == pytest.approx(sd, rel=0.012 + 4 / np.sqrt(2 * DRAWS))


def test_what_differs_between_units_besides_is_none_of_mass() -> None:
    random, x = np.random.default_rng(8), np.resize([0.0, 1.0, 1.0], CONDITIONS)
    levels = np.broadcast_to(7 + 0.2 * LOG_MASS + 0.5 * x, (*SHAPE, CONDITIONS))
    draws = slope_over_units(Units("trial", LOG_MASS, levels, x[:, None]), WIDE, LOG_PRIOR, random)
    # Nothing scatters about the plane, so that the spread is the least of the grid, or near it.
    assert np.abs(draws - 0.2).max() < 0.05


def test_impacts_of_linear_elements_have_no_exponent_of_the_kind() -> None:
    at = prepared()
    made = constrained(at, *np.zeros((3, PEOPLE * CONDITIONS)))
    del made.impacts["K_common_depth"]
    assert mass_exponents_of_secants(at, made, 0) == {}
