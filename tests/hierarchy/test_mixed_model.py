"""Group terms against another program: restricted maximum likelihood of statsmodels on exact estimates."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from numpy.testing import assert_allclose
from scipy.optimize import minimize, minimize_scalar

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected, expected_by_cell
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.gaussian.effects import (
    effects_from_standard,
    integrate_effects,
    log_density_of_cells,
)
from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.population import EffectParts, covariances_of, population_design
from bayestissue.hierarchy.priors import Normal, Priors
from designs import REFERENCE, design_of, impacts, indicator
from mixed_model_tables import DYESTUFF, PASTES, PENICILLIN, SLEEP

FORMULA = "log(mass_kg) + (log(mass_kg)|subject) + (1|subject:side) + (1|session)"
SD = {"subject": 0.3, "slope": 0.4, "side": 0.2, "session": 0.25, "impact": 0.1}
NAMES = {
    "subject": "sd_subject_K",
    "slope": "sd_subject_mass_exponent_K",
    "side": "sd_subject_side_K",
    "session": "sd_session_K",
    "impact": "sd_impact_K",
}
# Of second derivatives by differences, whose error is its square.
STEP = 1e-3


class Fitted(NamedTuple):
    """What statsmodels found: fixed effects, effects by level, and standard deviations."""

    fixed: np.ndarray
    effects: dict[str, float]
    sd: dict[str, float]


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    """Estimates of log K of ten people, made with `SD`."""
    table, rng = impacts(people=10), np.random.default_rng(8)
    x = np.log(table["mass_kg"].to_numpy() / REFERENCE)
    person = indicator(table, "subject")
    y = 8 + 0.5 * x + SD["impact"] * rng.normal(size=len(x))
    parts = {"subject": person, "slope": x[:, None] * person, "side": indicator(table, "subject", "side")}
    for name, Z in (parts | {"session": indicator(table, "session")}).items():
        y = y + Z @ (SD[name] * rng.normal(size=Z.shape[1]))
    return table.assign(y=y, x=x, all=1)


@pytest.fixture(scope="module")
def fitted(rows: pd.DataFrame) -> Fitted:
    components = {
        "subject": "0 + C(subject)",
        "slope": "0 + C(subject):x",
        "side": "0 + C(subject):C(side)",
        "session": "0 + C(session)",
    }
    model = smf.mixedlm("y ~ x", rows, groups="all", vc_formula=components)
    found = model.fit(reml=True, method=["bfgs", "lbfgs"])
    sd = dict(zip(sorted(components), np.sqrt(found.vcomp), strict=True))
    effects = found.random_effects[1].to_dict()
    return Fitted(found.fe_params.to_numpy(), effects, sd | {"impact": np.sqrt(found.scale)})


@pytest.fixture(scope="module")
def population(rows: pd.DataFrame) -> tuple[EffectParts, PopulationDesign]:
    """The design with flat priors of the fixed effects."""
    flat = dict.fromkeys("KC", Normal(distribution="normal", mean=0.0, sd=1e5))
    priors = Priors.model_validate({"intercept": flat, "mass_exponent": flat})
    return population_design(design_of(FORMULA, "1", rows), priors, ("noise",))


def told(
    population: tuple[EffectParts, PopulationDesign], y: Any, sd: dict[str, Any]
) -> tuple[PopulationDesign, Covariances, GaussianFactor]:
    """What exact estimates of log K say of b; of log C and the noise nothing is known."""
    effects, design = population
    sites = {NAMES[name]: jnp.asarray(value) for name, value in sd.items()}
    sites |= {"sd_impact_C": jnp.asarray(0.3), "sd_noise": jnp.asarray(0.3)}
    away = jnp.asarray(y) - expected(design, effects.mean)[0]
    precision, first = sites["sd_impact_K"] ** -2.0, jnp.array([1.0, 0.0, 0.0])[:, None]
    sums = (
        precision * first * away,
        precision * first[:, None] * first * jnp.ones_like(away),
        (jnp.log(precision) - precision * away**2) / 2,
    )
    about = expected_by_cell(design, effects.mean)
    laid = GaussianFactor(about, *(design.to_cells(part) for part in sums))
    return design, covariances_of(effects, sites, 0.0, ("noise",)), laid


def levels(values: np.ndarray) -> dict[str, np.ndarray]:
    """A table's rows as levels of `subject`, its values one after the other."""
    return {"subject": np.repeat([f"s{n}" for n in range(len(values))], values.shape[1])}


def columns(values: np.ndarray, repeats: int = 1) -> np.ndarray:
    """A name for each so many columns of a table, of every value."""
    return np.tile([f"c{n // repeats}" for n in range(values.shape[1])], len(values))


def greatest_objective(formula: str, values: np.ndarray, table: dict[str, np.ndarray], first: float) -> float:
    """Minus twice the greatest log likelihood, over standard deviations and fixed effects.

    The program integrates fixed effects out. Here they are known, to 1e-5, to be 0 of what is left of the
    values: so their own greatest is found like that of the others.
    """
    y, count = values.ravel(), values.size
    rows = impacts(people=1 + count // 12).iloc[:count].assign(mass_kg=REFERENCE).assign(**table)
    known, free = (Normal(distribution="normal", mean=0.0, sd=sd) for sd in (1e-5, 1.0))
    priors = Priors.model_validate(
        {"intercept": {"K": known, "C": free}, "mass_exponent": {"K": known, "C": free}}
    )
    population = population_design(design_of(formula, "1", rows), priors, ("noise",))
    x = np.log(rows["mass_kg"].to_numpy() / REFERENCE)
    X = np.stack([np.ones(count), x], axis=1)[:, : 1 + ("log" in formula)]
    names = ["impact", *(name for name, site in NAMES.items() if site in deviations(formula))]

    @jax.jit
    @jax.value_and_grad
    def objective(at: jax.Array) -> jax.Array:
        sd = dict(zip(names, jnp.exp(at[: len(names)]), strict=True))
        left = jnp.asarray(y) - X @ at[len(names) :]
        return -2 * log_density_of_cells(*told(population, left, sd)) + count * np.log(2 * np.pi)

    begin = np.r_[np.full(len(names), np.log(first)), np.linalg.lstsq(X, y, rcond=None)[0]]
    found = minimize(lambda at: objective(jnp.asarray(at)), begin, jac=True, method="BFGS")
    return float(found.fun)


def deviations(formula: str) -> list[str]:
    """The standard deviations that a formula of log K has between levels."""
    terms = {
        "(1|subject)": "sd_subject_K",
        "(1|subject:side)": "sd_subject_side_K",
        "(1|session)": "sd_session_K",
        "(log(mass_kg)|subject)": "sd_subject_mass_exponent_K",
    }
    found = [site for term, site in terms.items() if term in formula]
    return [*found, "sd_subject_K"] if "(log(mass_kg)|subject)" in formula else found


# The objectives are MixedModels.jl's. What fixed effects known to 1e-5 leave open is far below 1e-6, as is
# what a search that ends at slopes of 1e-5 does.
CLOSE = 1e-8


@pytest.mark.parametrize(
    ("values", "formula", "table", "first", "expected_objective"),
    [
        (DYESTUFF, "(1|subject)", {}, 40.0, 327.3270598811428),
        (PASTES, "(1|subject) + (1|subject:side)", {"side": columns(PASTES, 2)}, 1.0, 247.99446586325791),
        (PENICILLIN, "(1|subject) + (1|session)", {"session": columns(PENICILLIN)}, 1.0, 332.18834867227616),
    ],
    ids=["dyestuff", "pastes", "penicillin"],
)
def test_the_greatest_likelihood_is_that_of_mixed_models_jl(
    values: np.ndarray, formula: str, table: dict[str, np.ndarray], first: float, expected_objective: float
) -> None:
    found = greatest_objective(formula, values, levels(values) | table, first)
    assert found == pytest.approx(expected_objective, abs=CLOSE)


@pytest.mark.slow
def test_slopes_are_independent_of_intercepts_at_the_reference() -> None:
    """A correlation of the two is a matter of where the covariate is 0: one place has none.

    The greatest likelihood over all places is so that of MixedModels.jl with a correlation.
    """
    days = np.tile(np.arange(10.0), len(SLEEP))

    def objective(zero: float) -> float:
        table = levels(SLEEP) | {"mass_kg": REFERENCE * np.exp(days - zero)}
        return greatest_objective("log(mass_kg) + (log(mass_kg)|subject)", SLEEP, table, 20.0)

    best = minimize_scalar(objective, bracket=(-1.0, 0.0), tol=1e-5)
    assert best.fun == pytest.approx(1751.9393444663153, abs=CLOSE)
    assert objective(0.0) > best.fun


def test_effects_are_the_best_linear_unbiased_predictions(
    population: tuple[EffectParts, PopulationDesign], rows: pd.DataFrame, fitted: Fitted
) -> None:
    effects, names = population[0], list(fitted.sd)

    @jax.jit
    def means(sd: jax.Array) -> jax.Array:
        design, *known = told(population, rows["y"].to_numpy(), dict(zip(names, sd, strict=True)))
        found, _ = integrate_effects(design, *known)
        return effects_from_standard(design, found, jnp.asarray(effects.mean))

    b = np.asarray(means(jnp.array([fitted.sd[name] for name in names])))

    def part(name: str, levels: int) -> np.ndarray:
        return b[effects.parts[name]][:levels]

    fixed = np.r_[part("intercept_K", 1), part("mass_exponent_K", 1)]
    # Flat priors of 1e5 shift a coefficient of standard error 0.1 by a share of 1e-12.
    assert_allclose(fixed, fitted.fixed, rtol=1e-7)
    design = design_of(FORMULA, "1", rows)
    named = {
        "subject_effect_K": "subject[C(subject)[{0}]]",
        "subject_mass_exponent_deviation_K": "slope[C(subject)[{0}]:x]",
        "subject_side_effect_K": "side[C(subject)[{0}]:C(side)[{1}]]",
        "session_effect_K": "session[C(session)[{0}]]",
    }
    for term in design.responses["K"].terms:
        levels = design.groupings[term.grouping].levels
        own = part(term.effect("K"), len(levels))
        keys = [named[term.effect("K")].format(*level.split(":")) for level in levels]
        assert_allclose(own, [fitted.effects[key] for key in keys], rtol=0, atol=1e-7, err_msg=str(term))


@pytest.mark.slow
def test_restricted_likelihood_is_greatest_where_statsmodels_finds_it(
    population: tuple[EffectParts, PopulationDesign], rows: pd.DataFrame, fitted: Fitted
) -> None:
    names = list(fitted.sd)

    def log_density(log_sd: jax.Array) -> jax.Array:
        sd = dict(zip(names, jnp.exp(log_sd), strict=True))
        return log_density_of_cells(*told(population, rows["y"].to_numpy(), sd))

    at = np.log([fitted.sd[name] for name in names])
    slope_at = jax.jit(jax.grad(log_density))
    slope = np.asarray(slope_at(jnp.asarray(at)))
    bend = np.array([(slope_at(at + step) - slope_at(at - step)) / (2 * STEP) for step in STEP * np.eye(5)])
    # In standard errors of the logs of the standard deviations: the optimiser's own tolerance.
    away = np.linalg.solve(-bend, slope) * np.sqrt(np.diag(-bend))
    assert_allclose(away, 0, atol=0.01)
    # And what it finds is what the data were made with, within four standard errors.
    error = np.sqrt(np.diag(np.linalg.inv(-bend)))
    assert (np.abs(at - np.log([SD[name] for name in names])) < 4 * error).all()
