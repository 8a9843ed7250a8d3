"""By how much declared masses are wrong, in each draw: one by one, by person, or all by one factor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.elements import element
from bayestissue.hierarchy.effects import RESPONSES, parameter_of
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.population import Population, force_ratio, heavier, of_impacts
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel
from bayestissue.inference.execution.compiling import by_row

# Draws of one call.
DRAWS = 256
# What all declared masses are to be multiplied by.
MASS_FACTOR = "mass_factor"


def common_log_factor(
    prepared: Prepared, population: Population, key: Array
) -> Float[np.ndarray, "chain draw"] | None:
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


def declared_common_sd(prepared: Prepared) -> float | None:
    """Of the log of a factor that all masses have in common, as declared; None where each errs by itself."""
    known = prepared.force or prepared.reference
    return (prepared.common_mass_sd or None) if known is None else known.mass_sd


def driven_gains(
    prepared: Prepared, shape: tuple[int, int], key: Array
) -> Float[np.ndarray, "chain draw channel"]:
    """Logs of the gains of displacement and force, one pair of all impacts of a driven tissue."""
    standard = np.asarray(jax.random.normal(jax.random.fold_in(key, 14), (*shape, 2)))
    return np.asarray(prepared.gain_sd) * standard


def of_heavier_impactors(
    model: TraceModel,
    b: Float[np.ndarray, "chain draw location"],
    log_factor: Float[np.ndarray, "chain draw"],
) -> Float[np.ndarray, "chain draw location"]:
    """Effects at masses that are greater by a factor: K, C and any mass of the element go with it."""
    masses = (parameter_of(one.name) for one in element(model.element).extra if one.of_mass)
    return heavier(model.locations, b, log_factor, (*RESPONSES, *masses))


def own_log_factor(
    prepared: Prepared, population: Population, u: Float[np.ndarray, "chain draw impact parameter"]
) -> Float[np.ndarray, "chain draw impact"]:
    """What an impact's own mass errs by beside `common_log_factor`, by a force's ratio to its mean."""
    if prepared.force is None or not prepared.force.share:
        return np.zeros(u.shape[:-1])
    return u[..., -1] - population.b[..., force_ratio(prepared.model.locations)][..., None]


@by_row(DRAWS, constant=2, axes=2)
def mass_errors(
    model: TraceModel,
    design: PopulationDesign,
    population: Population,
    u: Float[Array, "impact parameter"],
    key: Array,
) -> Float[Array, " impact"]:
    """The error of every impact's log mass."""
    covariances = model.covariances(population.hyperparameters)
    if covariances.shared is not None:
        return of_impacts(design, covariances, error_of_people(covariances, population.b, key))
    pair = [entry - model.log_mass_sd**2 for entry in covariances.pair]
    return error_given(model.log_mass_sd**2, pair, u.T - expected(design, population.b), key)


@by_row(DRAWS, constant=1, axes=2)
def at_true_masses(model: TraceModel, population: Population, key: Array) -> Float[Array, " location"]:
    """People's effects in b put at their true mass."""
    covariances, b = model.covariances(population.hyperparameters), population.b
    if covariances.shared is None:
        return b
    error = error_of_people(covariances, b, key)
    effects = jnp.concatenate([covariances.shared.effect_on_K, covariances.shared.effect_on_C])
    return b + jax.ops.segment_sum(jnp.tile(error, 2), effects, len(b))


def error_of_people(covariances: Covariances, b: Array, key: Array) -> Float[Array, " person"]:
    """The error of the log mass that a person's impacts share, given the effects at the recorded mass."""
    assert covariances.shared is not None  # noqa: S101 - the callers ask
    on_K, on_C, variance = covariances.shared
    K, C = covariances.locations[on_K] ** 2, covariances.locations[on_C] ** 2
    return error_given(variance, (K, 0.0, C), (b[on_K], b[on_C]), key)


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
