"""By how much declared masses are wrong, in each draw: one by one, several together, or all by one factor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.base.arrays import JaxPerImpact, JaxPerParameter, PerDraw
from bayestissue.inference.execution.compiling import by_row
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected
from bayestissue.model.hierarchy.population import Population, force_ratio, heavier, shared_mass_errors
from bayestissue.model.hierarchy.trace_data import Prepared, in_proportion_to_mass
from bayestissue.model.hierarchy.trace_models import TraceModel

# Draws of one call.
DRAWS = 256
# What all declared masses are to be multiplied by.
MASS_FACTOR = "mass_factor"
# What a force's sensor shows of the true force, over what the accelerometer shows of the true deceleration.
GAIN_FACTOR = "gain_factor"


def common_log_factor(prepared: Prepared, population: Population, key: Array) -> PerDraw | None:
    """Log of what all masses are to be multiplied by, K and C with them; None where each errs by itself.

    A force beside the deceleration tells it, or phantoms of known stiffness, or it is as declared.
    """
    force, reference = prepared.force, prepared.reference
    if declared_common_sd(prepared) is None:
        return None
    standard = np.asarray(jax.random.normal(jax.random.fold_in(key, 12), population.b.shape[:2]))
    if force is not None:
        return force.log_mass_factor(population.b[..., force_ratio(prepared.model.locations)], standard)
    if reference is not None:
        return reference.log_mean + reference.log_sd * standard
    return prepared.common_mass_sd * standard


def with_common_factor(
    prepared: Prepared,
    b: Float[np.ndarray, "chain draw location"],
    log_factor: PerDraw,
    log_gain: PerDraw | None,
) -> tuple[Float[np.ndarray, "chain draw location"], dict[str, np.ndarray]]:
    """Effects at masses that are greater by a factor, and the factors by their names.

    K, C and any mass of the element go with all masses; both gains have one where a force is recorded.
    """
    factors = {MASS_FACTOR: np.exp(log_factor)}
    if log_gain is not None:
        factors[GAIN_FACTOR] = np.exp(log_gain)
    model = prepared.model
    return heavier(model.locations, b, log_factor, in_proportion_to_mass(model.element)), factors


def declared_common_sd(prepared: Prepared) -> float | None:
    """Of the log of a factor that all masses have in common, as declared; None where each errs by itself."""
    known = prepared.force or prepared.reference
    return (prepared.common_mass_sd or None) if known is None else known.mass_sd


@by_row(DRAWS, constant=2, axes=2)
def mass_errors(
    model: TraceModel, design: PopulationDesign, population: Population, u: JaxPerParameter, key: Array
) -> JaxPerImpact:
    """The error of every impact's log mass."""
    if model.locations.of_shared_masses:
        return shared_mass_errors(model.locations, design, population.b)
    covariances = model.covariances(population.hyperparameters)
    pair = [entry - model.log_mass_sd**2 for entry in covariances.pair]
    return error_given(model.log_mass_sd**2, pair, u.T - expected(design, population.b), key)


def error_given(
    variance: Any, pair: Sequence[Any], deviation: Sequence[Any] | Array, key: Array
) -> Float[Array, " one"]:
    """A draw of the error e of the log mass, N(0, v), given log K - e and log C - e: all that is seen.

    With the covariance (KK, KC, CC) of log K and log C its mean is -v ((CC - KC) f_K + (KK - KC) f_C) / d and
    its variance v (KK CC - KC^2) / d, where d = KK CC - KC^2 + v (KK + CC - 2 KC).

    Args:
        variance: v.
        pair: the covariance without the error.
        deviation: f, log K - e and log C - e less their means.
        key: of the draw.
    """
    kk, kc, cc = pair
    determinant = jnp.maximum(kk * cc - kc**2, 0.0)
    over = variance / (determinant + variance * (kk + cc - 2 * kc))
    mean = -over * ((cc - kc) * deviation[0] + (kk - kc) * deviation[1])
    return mean + jnp.sqrt(over * determinant) * jax.random.normal(key, mean.shape)
