"""Objectives of mixed-model programs, by the hierarchy's own algebra.

The tables are those of lme4 (Bates, Mächler, Bolker and Walker 2015, doi:10.18637/jss.v067.i01), which has
them from Davies, The Design and Analysis of Industrial Experiments (1949), Davies and Goldsmith, Statistical
Methods in Research and Production (1972), and Belenky and others, Journal of Sleep Research (2003). They
stand in ``published_numbers.toml``, one row a level of the first factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Float

from bayestissue.base.declarations import declared
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected, expected_by_cell
from bayestissue.model.hierarchy.gaussian.effects import Covariances, integrate_effects
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.population import EffectParts, covariances_of, population_design
from bayestissue.model.hierarchy.priors import Normal, Priors
from bayestissue.model.hierarchy.specification import Formulas
from bayestissue.model.likelihood.small import LOG_2PI

# Of what plays the part of the mass; log(mass_kg) is the covariate of a slope.
REFERENCE = 0.8
# Of fixed effects, which the program integrates out: what they leave open is far below 1e-6 of an objective.
_KNOWN = 1e-5
_FURTHER = ("sd_impact_C", "sd_noise")
_ANY = 0.3


def data(name: str) -> Float[np.ndarray, "level value"]:
    """One of the tables of ``published_numbers.toml``."""
    rows = declared(__package__, "published_numbers.toml")["data"][name].strip().splitlines()
    return np.array([row.split() for row in rows], float)


def columns(values: Float[np.ndarray, "level value"], repeats: int = 1) -> np.ndarray:
    """A name for each so many columns of a table, of every value."""
    return np.tile([f"c{n // repeats}" for n in range(values.shape[1])], len(values))


def exactly_estimated(
    population: tuple[EffectParts, PopulationDesign], y: Float[Any, " impact"], sd: Mapping[str, Any]
) -> tuple[PopulationDesign, Covariances, GaussianFactor]:
    """What exact estimates y of log K say of all effects b; of log C and the noise nothing is known.

    Args:
        population: parts of b and their design, as `population_design` has them.
        y: log K of each impact.
        sd: standard deviations of log K, by the names of their sites.

    Returns:
        What `integrate_effects` takes.
    """
    effects, design = population
    sites = {name: jnp.asarray(value) for name, value in (dict.fromkeys(_FURTHER, _ANY) | dict(sd)).items()}
    residual = jnp.asarray(y) - expected(design, jnp.asarray(effects.mean))[0]
    precision, first = sites["sd_impact_K"] ** -2.0, jnp.array([1.0, 0.0, 0.0])[:, None]
    sums = (
        precision * first * residual,
        precision * first[:, None] * first * jnp.ones_like(residual),
        (jnp.log(precision) - precision * residual**2) / 2,
    )
    of_cells = expected_by_cell(design, effects.mean)
    factor = GaussianFactor(of_cells, *(design.to_cells(part) for part in sums))
    return design, covariances_of(effects, sites, 0.0, ("noise",)), factor


def least_objective(
    formula: str, values: Float[np.ndarray, "level value"], table: Mapping[str, np.ndarray], first_sd: float
) -> float:
    """Minus twice the greatest log likelihood, over standard deviations and fixed effects.

    The program integrates fixed effects out. Here they are known, to `_KNOWN`, to be 0 of what is left of the
    values: so their own greatest is found like that of the others.

    Args:
        formula: of log K.
        values: a table, of which the rows are the levels of `subject`.
        table: further columns, one entry a value, and mass_kg where the formula has it.
        first_sd: of every standard deviation, where the search begins.
    """
    from scipy.optimize import minimize

    y, count = values.ravel(), values.size
    subject = np.repeat([f"s{n}" for n in range(len(values))], values.shape[1])
    rows = pd.DataFrame({"impact": np.arange(count), "trial": "t", "mass_kg": REFERENCE, "subject": subject})
    rows = rows.assign(**table)
    known, free = (Normal(distribution="normal", mean=0.0, sd=sd) for sd in (_KNOWN, 1.0))
    fixed_effects = {"K": known, "C": free}
    priors = Priors.model_validate({"intercept": fixed_effects, "mass_exponent": fixed_effects})
    design = build_design(Formulas(K=formula, C="1"), rows, reference_mass_kg=REFERENCE, source="selftest")
    population = population_design(design, priors, ("noise",))
    x = np.log(rows["mass_kg"].to_numpy() / REFERENCE)
    X = np.stack([np.ones(count), x], axis=1)[:, : 1 + ("log" in formula)]
    names = ["sd_impact_K", *(term.sd("K") for term in design.responses["K"].terms)]

    @jax.jit
    @jax.value_and_grad
    def objective(at: Array) -> Array:
        sd = dict(zip(names, jnp.exp(at[: len(names)]), strict=True))
        left = jnp.asarray(y) - X @ at[len(names) :]
        return -2 * integrate_effects(*exactly_estimated(population, left, sd))[1] + count * LOG_2PI

    def value_and_slope(at: Float[np.ndarray, " parameter"]) -> tuple[float, Float[np.ndarray, " parameter"]]:
        value, slope = objective(jnp.asarray(at))
        return float(value), np.asarray(slope)

    begin = np.r_[np.full(len(names), np.log(first_sd)), np.linalg.lstsq(X, y, rcond=None)[0]]
    return float(minimize(value_and_slope, begin, jac=True, method="BFGS").fun)


def sleep_objective(zero: float) -> float:
    """Of reaction times with a slope and an intercept of each person that are independent at day ``zero``.

    A correlation of the two is a matter of where the covariate is 0: in one place there is none, and the
    least objective over all places is that of a program that has the correlation as a parameter.
    """
    times = data("sleep")
    days = np.tile(np.arange(10.0), len(times))
    mass = {"mass_kg": REFERENCE * np.exp(days - zero)}
    return least_objective("log(mass_kg) + (log(mass_kg)|subject)", times, mass, 20.0)
