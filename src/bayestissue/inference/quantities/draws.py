"""From draws of hyperparameters, effects and impacts to all quantities, of posterior and prior alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Float, Int
from numpyro.infer import Predictive

from bayestissue.elements import element
from bayestissue.elements.outcomes import OUTCOMES
from bayestissue.hierarchy import derived
from bayestissue.hierarchy.effects import RESPONSES, intercept, parameter_of
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.population import Population, of_impacts
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, impacts_model
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.execution.compiling import by_row, compiled_quickly
from bayestissue.inference.quantities.impacts import NAMES, Impacts, impact_quantities, named_quantities
from bayestissue.padding import padded_impacts, padded_rows

# Draws of one call, and of a prior.
DRAWS, PRIOR_DRAWS = 256, 1000
# What all declared masses are to be multiplied by.
MASS_FACTOR = "mass_factor"
# Of the rows of a block and its impacts' parameters: the errors of log mass, and a key of each draw.
ErrorsAndKeys = Callable[[np.ndarray, np.ndarray], tuple[Any, Any]]


@dataclass(frozen=True)
class Draws:
    """Draws of a posterior or a prior by name, each array [chain, draw, ...].

    Attributes:
        population: hyperparameters, and effects as `effects_by_name` has them, people's at their true mass.
        impacts: what `impact_quantities` has of every impact.
        log_likelihood: log density of each impact, subject and trial with its own parameters and effects
            integrated out.
        kept_numbers: if not None, impacts have these draws of each chain only, and log densities are those of
            some impacts.
    """

    population: dict[str, np.ndarray]
    impacts: dict[str, np.ndarray]
    log_likelihood: dict[str, np.ndarray]
    kept_numbers: np.ndarray | None = None


def posterior_draws(
    prepared: Prepared,
    population: Population,
    u: Float[np.ndarray, "chain kept impact parameter"],
    kept_numbers: Int[np.ndarray, " kept"],
    key: Array,
    log_likelihood: dict[str, np.ndarray],
) -> Draws:
    """Everything that draws of the population and of impacts' parameters stand for.

    Args:
        prepared: the fit.
        population: all draws, [chain, draw, ...].
        u: parameters of every impact, of the draws that are kept.
        kept_numbers: of the draws of each chain that are kept of impacts.
        key: of what is drawn besides: the measuring chain's errors, and those of mass.
        log_likelihood: see `Draws`.
    """
    model, design, shape = prepared.model, prepared.data.design, population.b.shape[:2]
    cell, whole = np.asarray(design.cell), len(kept_numbers) == shape[1]
    # In numpy: jax compiles each step of choosing some of them anew for every number of draws.
    keys = np.asarray(jax.random.split(jax.random.fold_in(key, 11), shape))
    of_kept, keys_of_kept = jax.tree.map(lambda values: values[:, kept_numbers], (population, keys))

    force, a = prepared.force, population.b[..., _ratio_mean(model)]
    log_factor = np.zeros(shape)
    if prepared.gain_sd:
        log_factor = prepared.gain_sd * np.asarray(jax.random.normal(jax.random.fold_in(key, 14), shape))
    if force is not None:
        standard = np.asarray(jax.random.normal(jax.random.fold_in(key, 12), shape))
        log_factor = force.log_mass_factor(a, standard)
    elif (reference := prepared.reference) is not None:
        standard = np.asarray(jax.random.normal(jax.random.fold_in(key, 12), shape))
        log_factor = reference.log_mean + reference.log_sd * standard

    def errors_and_keys(rows: np.ndarray, u: np.ndarray) -> tuple[Any, Any]:
        of_block = _each(partial(jax.random.fold_in, data=rows[0]), keys_of_kept)
        of_errors, of_mass = np.moveaxis(_each(jax.random.split, of_block), 2, 0)
        if prepared.gain_sd:
            return np.broadcast_to(log_factor[:, kept_numbers, None], u.shape[:-1]), of_errors
        # Of the design X b of these impacts is asked alone.
        if force is not None:
            # What an impact's ratio has beside the common one is its own mass's.
            scatter = u[..., -1] - a[:, kept_numbers, None] if force.share else np.zeros(u.shape[:-1])
            return log_factor[:, kept_numbers, None] + scatter, of_errors
        if prepared.reference is not None:
            return np.broadcast_to(log_factor[:, kept_numbers, None], u.shape[:-1]), of_errors
        of_rows = design._replace(cell=cell[rows[padded_rows(len(rows))]])
        of_people = keys_of_kept if model.mass_error == "subject" else of_mass
        return _mass_errors(model, of_rows, of_kept, u, of_people), of_errors

    impacts = _of_impacts(prepared, u, errors_and_keys, recorded=True, single=not whole)
    b = _heavier(model, _at_true_masses(model, population, keys), log_factor)
    factor = {} if force is None and prepared.reference is None else {MASS_FACTOR: np.exp(log_factor)}
    return Draws(
        population.hyperparameters | derived.effects_by_name(model.locations, prepared.design, b) | factor,
        impacts,
        log_likelihood,
        None if whole else kept_numbers,
    )


def prior_draws(prepared: Prepared, seed: int, rng: np.random.Generator) -> Draws:
    """The same as the priors alone have it, of one chain."""
    model, data = prepared.model, prepared.data
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 13)
    drawn, u = drawn_from_prior(model, data, key)
    factor: dict[str, np.ndarray] = {}
    if "log_mass_error" in drawn:
        people = pd.Index(prepared.design.subjects)
        error = drawn["log_mass_error"][
            ..., people.get_indexer(pd.Index(prepared.impacts["subject"].astype(str)))
        ]
    elif (common := prepared.force or prepared.reference) is not None:
        error = np.broadcast_to(common.mass_sd * rng.standard_normal(u.shape[:2])[..., None], u.shape[:-1])
        drawn["locations"] = _heavier(model, drawn["locations"], error[..., 0])
        factor = {MASS_FACTOR: np.exp(error[..., 0])}
    else:
        error = model.log_mass_sd * rng.standard_normal(u.shape[:-1])
    keys = np.asarray(jax.random.split(jax.random.fold_in(key, 1), u.shape[:2]))

    def errors_and_keys(rows: np.ndarray, u: np.ndarray) -> tuple[Any, Any]:
        return padded_impacts(error[:, :, rows], 2), keys

    impacts = _of_impacts(prepared, u, errors_and_keys, recorded=False)
    # The measuring chain's errors are as the dataset states them.
    impacts.pop("chain_error")
    effects = derived.effects_by_name(model.locations, prepared.design, drawn["locations"])
    return Draws({name: drawn[name] for name in model.hyperparameters} | effects | factor, impacts, {})


def quantities(prepared: Prepared, draws: Draws, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """All quantities by the names of ``posterior.nc``; ``rng`` is for those of a new impact."""
    design, population, impacts = prepared.design, draws.population, draws.impacts
    values = derived.formula_quantities(design, population)
    for name in prepared.model.nuisance:
        values |= {which: population[which] for which in (f"{name}_mean", f"sd_{name}")}
    values |= {name: population[name] for name in (MASS_FACTOR,) if name in population}
    levels = derived.level_quantities(design, values)
    values |= levels | {name: impacts[name] for name in NAMES if name in impacts}
    if "chain_error" in impacts:
        record = prepared.data.record
        known = np.asarray(record.error_sd).any(axis=0)
        values |= {name: impacts["chain_error"][..., i] for i, name in enumerate(record.errors) if known[i]}
    return values | derived.new_impact(design, population, levels, rng)


def _each(function: Callable[..., Array], keys: Any) -> np.ndarray:
    """Of the key of each draw, [chain, draw, ...]."""
    return np.asarray(jax.vmap(jax.vmap(function))(keys))


def _of_impacts(
    prepared: Prepared,
    u: Float[np.ndarray, "chain draw impact parameter"],
    errors_and_keys: ErrorsAndKeys,
    *,
    recorded: bool,
    single: bool = False,
) -> dict[str, Float[np.ndarray, "chain draw impact ..."]]:
    """What `impact_quantities` has of every impact, block by block, in ``single`` precision if so."""

    def one(part: TraceData, rows: np.ndarray) -> dict[str, np.ndarray]:
        of_rows = padded_impacts(u[:, :, rows], 2)
        errors = errors_and_keys(rows, of_rows)
        padded = drawn_impacts(prepared.model, part.padded, recorded, of_rows, *errors)
        values = {name: np.moveaxis(array[:, :, : len(rows)], 2, 0) for name, array in padded.items()}
        # Seven digits of a draw are more than it knows, and half the memory.
        return {name: array.astype(np.float32) for name, array in values.items()} if single else values

    return {name: np.moveaxis(values, 0, 2) for name, values in in_blocks(prepared.data, one).items()}


@by_row(DRAWS, constant=3, axes=2)
def drawn_impacts(
    model: TraceModel,
    data: TraceData,
    recorded: bool,
    u: Float[Array, "impact parameter"],
    mass_error: Float[Array, " impact"],
    key: Array,
) -> dict[str, Float[Array, "impact ..."]]:
    """Every impact's quantities, as what was recorded has them or the priors alone; compiled for both."""
    return impact_quantities(Impacts.drawn(model, data, list(u.T), mass_error, key, jnp.asarray(recorded)))


@by_row(DRAWS, constant=2)
def recorded_outcomes(
    model: TraceModel,
    data: TraceData,
    u: Float[Array, "impact parameter"],
    mass_error: Float[Array, " impact"],
    key: Array,
) -> dict[str, Float[Array, " impact"]]:
    """The outcomes alone, given what was recorded: compiled sooner than `drawn_impacts` is."""
    impacts = Impacts.drawn(model, data, list(u.T), mass_error, key, jnp.asarray(True))
    return named_quantities(impacts, OUTCOMES)


def drawn_from_prior(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "chain draw impact parameter"]]:
    """One chain's hyperparameters, effects as "locations", people's errors of mass; impacts' parameters."""
    drawn = jax.device_get(_drawn_from_prior(model, data.padded, key))
    population, u = jax.tree.map(lambda values: values[None], drawn)
    return population, u[:, :, : len(data.log_mass)]


@compiled_quickly
def _drawn_from_prior(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[dict[str, Array], Float[Array, "draw impact parameter"]]:
    """What is compiled of `drawn_from_prior`."""
    shared = ["log_mass_error"] if model.mass_error == "subject" else []
    bare = Predictive(
        lambda: impacts_model(model, data),
        num_samples=PRIOR_DRAWS,
        return_sites=[*model.hyperparameters, "locations", "log_K_and_C", *model.nuisance, *shared],
    )
    drawn = bare(key)
    nuisance = [drawn.pop(name)[..., None] for name in model.nuisance]
    return drawn, jnp.concatenate([drawn.pop("log_K_and_C"), *nuisance], axis=-1)


@by_row(DRAWS, constant=2, axes=2)
def _mass_errors(
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
def _at_true_masses(model: TraceModel, population: Population, key: Array) -> Float[Array, " location"]:
    """People's effects in b put at their true mass."""
    covariances, b = model.covariances(population.hyperparameters), population.b
    if covariances.shared is None:
        return b
    error = error_of_people(covariances, b, key)
    effects = jnp.concatenate([covariances.shared.effect_on_K, covariances.shared.effect_on_C])
    return b + jax.ops.segment_sum(jnp.tile(error, 2), effects, len(b))


def _ratio_mean(model: TraceModel) -> int:
    """Which element of b is the common log of force over mass times deceleration; of no force any."""
    return model.locations.parts["log_force_ratio_mean"].start if model.force else 0


def _heavier(
    model: TraceModel,
    b: Float[np.ndarray, "chain draw location"],
    log_factor: Float[np.ndarray, "chain draw"],
) -> Float[np.ndarray, "chain draw location"]:
    """Effects with K, C and what else goes with the mass, of so much heavier impactors."""
    if not log_factor.any():
        return b
    moved = np.array(b)
    further = (parameter_of(one.name) for one in element(model.element).extra if one.of_mass)
    for parameter in (*RESPONSES, *further):
        moved[..., model.locations.parts[intercept(parameter)].start] += log_factor
    return moved


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
