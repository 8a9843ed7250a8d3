"""What effects of people and conditions may not depend on, and what more impacts do to them."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.model.hierarchy.gaussian.effects import (
    effects_from_standard,
    integrate_effects,
)
from bayestissue.model.hierarchy.population import EffectParts, population_design
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.studies.selftest.published_numbers import exactly_estimated
from designs import design_of, impacts

FORMULA = "log(mass_kg) + age + (log(mass_kg)|subject) + (1|subject:side) + (1|session)"
SD = {
    "sd_impact_K": 0.1,
    "sd_subject_K": 0.3,
    "sd_subject_mass_exponent_K": 0.4,
    "sd_subject_side_K": 0.2,
    "sd_session_K": 0.25,
}
ROWS = impacts(people=4)
Y = 8 + 0.3 * np.random.default_rng(3).normal(size=len(ROWS))
# Sums of some fifty terms in another order, of a log density of some tens.
ROUNDING = 1e-9


def arranged(rows: pd.DataFrame) -> tuple[EffectParts, PopulationDesign]:
    design = design_of(FORMULA, "1", rows)
    return population_design(design, Priors(), ("noise",))


def log_density(rows: pd.DataFrame, y: np.ndarray) -> float:
    effects, design = arranged(rows)
    return float(_log_density(design, effects, jnp.asarray(y)))


@partial(jax.jit, static_argnames="effects")
def _log_density(design: PopulationDesign, effects: EffectParts, y: jax.Array) -> jax.Array:
    return integrate_effects(*exactly_estimated((effects, design), y, SD))[1]


def sd_of_means(rows: pd.DataFrame, y: np.ndarray) -> np.ndarray:
    """Standard deviations of b given the data."""
    effects, design = arranged(rows)
    return np.asarray(_sd_of_means(design, effects, jnp.asarray(y)))


@partial(jax.jit, static_argnames="effects")
def _sd_of_means(design: PopulationDesign, effects: EffectParts, y: jax.Array) -> jax.Array:
    conditional, _ = integrate_effects(*exactly_estimated((effects, design), y, SD))
    zero, unit = jnp.zeros(effects.size), jnp.eye(effects.size)
    middle = effects_from_standard(design, conditional, zero)
    away = jax.vmap(lambda z: effects_from_standard(design, conditional, zero, z))(unit) - middle
    return jnp.sqrt(jnp.square(away).sum(axis=0))


@pytest.fixture(scope="module")
def density() -> float:
    return log_density(ROWS, Y)


@given(st.permutations(range(len(ROWS))))
@settings(max_examples=5, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_the_order_of_impacts_does_not_matter(density: float, order: list[int]) -> None:
    """So two files, or two halves of a study, one after the other in any order are the study."""
    assert log_density(ROWS.iloc[order].reset_index(drop=True), Y[order]) == pytest.approx(density, ROUNDING)


def test_names_of_levels_do_not_matter(density: float) -> None:
    names = {
        column: ROWS[column].map(lambda name: f"z{hash_of(name)}")
        for column in ("subject", "side", "session")
    }
    assert log_density(ROWS.assign(**names), Y) == pytest.approx(density, ROUNDING)


def hash_of(name: object) -> int:
    """Another order of the names."""
    return sum(ord(letter) * 7**place for place, letter in enumerate(str(name))) % 101


def test_a_constant_added_to_a_covariate_does_not_matter(density: float) -> None:
    assert log_density(ROWS.assign(age=ROWS["age"] + 1000), Y) == pytest.approx(density, ROUNDING)


def test_more_impacts_make_no_mean_less_certain() -> None:
    half = ROWS.iloc[::2].reset_index(drop=True)
    fewer, more = sd_of_means(half, Y[::2]), sd_of_means(ROWS, Y)
    assert fewer.shape == more.shape
    assert (more <= fewer * (1 + ROUNDING)).all()
    assert (more < fewer).sum() > len(more) / 2
