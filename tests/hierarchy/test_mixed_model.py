"""Group terms against other programs: restricted maximum likelihood of statsmodels on exact estimates, and
MixedModels.jl's objectives."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from numpy.testing import assert_allclose

from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.model.hierarchy.gaussian.effects import (
    effects_from_standard,
    integrate_effects,
)
from bayestissue.model.hierarchy.population import EffectParts, population_design
from bayestissue.model.hierarchy.priors import Normal, Priors
from bayestissue.studies.selftest.published_numbers import PUBLISHED, exactly_estimated, sleep_objective
from designs import REFERENCE, design_of, impacts, indicator

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


@pytest.mark.parametrize("name", ["Dyestuff", "Pastes", "Penicillin"])
def test_the_least_objective_is_that_of_mixed_models_jl(name: str) -> None:
    published = PUBLISHED[name]
    assert published.differences(published.computed()) == {}


@pytest.mark.slow
def test_slopes_are_independent_of_intercepts_at_the_reference() -> None:
    published = PUBLISHED["sleepstudy"]
    found = published.computed()
    assert published.differences(found) == {}
    assert sleep_objective(0.0) > found["objective"]


def test_effects_are_the_best_linear_unbiased_predictions(
    population: tuple[EffectParts, PopulationDesign], rows: pd.DataFrame, fitted: Fitted
) -> None:
    effects, sites = population[0], [NAMES[name] for name in fitted.sd]

    @jax.jit
    def means(sd: jax.Array) -> jax.Array:
        design, *known = exactly_estimated(
            population, rows["y"].to_numpy(), dict(zip(sites, sd, strict=True))
        )
        found, _ = integrate_effects(design, *known)
        return effects_from_standard(design, found, jnp.asarray(effects.mean))

    b = np.asarray(means(jnp.array(list(fitted.sd.values()))))

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
        sd = dict(zip(map(NAMES.get, names), jnp.exp(log_sd), strict=True))
        return integrate_effects(*exactly_estimated(population, rows["y"].to_numpy(), sd))[1]

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
