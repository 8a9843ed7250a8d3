"""From draws of hyperparameters, effects and impacts to all quantities, of posterior and prior alike.

Also by how much declared masses are wrong in each draw (one by one, several together, or all by one factor),
and replicates of every trace.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from numpyro.infer import Predictive

from bayestissue.base.impact_arrays import (
    JaxPerImpact,
    JaxPerParameter,
    JaxPerSample,
    PerDraw,
    padded_impacts,
    padded_rows,
)
from bayestissue.base.outcome_table import HEADFORM_OUTCOMES, OUTCOMES
from bayestissue.inference.execution.chunks import map_impacts
from bayestissue.inference.execution.compiling import by_row, compiled_quickly, padded
from bayestissue.inference.execution.kept import all_kept, some_impacts
from bayestissue.inference.quantities.impact_quantities import (
    NAMES,
    Impacts,
    impact_quantities,
    named_quantities,
)
from bayestissue.inference.samplers.sampling import flat, in_chains
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, expected
from bayestissue.model.hierarchy.population import Population, force_ratio, heavier, shared_mass_errors
from bayestissue.model.hierarchy.trace_data import Prepared, in_proportion_to_mass
from bayestissue.model.hierarchy.trace_models import TraceData, TraceModel, impacts_model, trace_likelihood

PRIOR_DRAWS = 1000
# Draws of one call.
DRAWS = 256
# What all declared masses are to be multiplied by.
MASS_FACTOR = "mass_factor"
# What a force's sensor shows of the true force, over what the accelerometer shows of the true deceleration.
GAIN_FACTOR = "gain_factor"
PREDICTIVE_DRAWS, PRIOR_PREDICTIVE_DRAWS = 100, 50
# Steps of a replicate, in what its noise differs by from sample to sample: they add 1e-5 to its variance.
_STEPS = 64
# Below every digit of a double: nothing is rounded.
_NO_NOISE = 2.0**-80
# Of the rows of a block and its impacts' parameters: the errors of log mass, and a key of each draw.
ErrorsAndKeys = Callable[[np.ndarray, np.ndarray], tuple[Any, Any]]


@dataclass(frozen=True)
class Draws:
    """Draws of a posterior or a prior by name, each array [chain, draw, ...].

    Attributes:
        population: hyperparameters, and effects as `effects_by_name` has them, at the true masses.
        impacts: what `impact_quantities` has of every impact.
        log_likelihood: log density of each impact, subject and trial with its own parameters and effects
            integrated out.
        kept_numbers: if not None, impacts have these draws of each chain only, and log densities are those of
            some impacts.
    """

    population: dict[str, np.ndarray]
    impacts: dict[str, np.ndarray]
    log_likelihood: Mapping[str, np.ndarray] = MappingProxyType({})
    kept_numbers: np.ndarray | None = None


def posterior_draws(
    prepared: Prepared,
    population: Population,
    u: Float[np.ndarray, "chain kept impact parameter"],
    kept_numbers: Int[np.ndarray, " kept"],
    key: Array,
) -> Draws:
    """Everything that draws of the population and of impacts' parameters stand for.

    Args:
        prepared: the fit.
        population: all draws, [chain, draw, ...].
        u: parameters of every impact, of the draws that are kept.
        kept_numbers: of the draws of each chain that are kept of impacts.
        key: of what is drawn besides: the measuring chain's errors, and those of mass.
    """
    model, design, shape = prepared.model, prepared.data.design, population.b.shape[:2]
    cell, whole = np.asarray(design.cell), all_kept(len(prepared.impacts))
    # In numpy: jax compiles each step of choosing some of them anew for every number of draws.
    keys = np.asarray(jax.random.split(jax.random.fold_in(key, 11), shape))
    of_kept, keys_of_kept = jax.tree.map(lambda values: values[:, kept_numbers], (population, keys))
    log_factor = common_log_factor(prepared, population, key)

    def errors_and_keys(rows: np.ndarray, u: np.ndarray) -> tuple[Any, Any]:
        of_block = _each(partial(jax.random.fold_in, data=rows[0]), keys_of_kept)
        of_errors, of_mass = np.moveaxis(_each(jax.random.split, of_block), 2, 0)
        if log_factor is not None:
            errors = np.broadcast_to(log_factor[:, kept_numbers, None], u.shape[:-1])
            if prepared.force and prepared.force.share:
                # What an impact's own mass errs by besides, by a force's ratio to its mean.
                errors = errors + u[..., -1] - of_kept.b[..., force_ratio(model.locations)][..., None]
            return errors, of_errors
        # Of the design X b of these impacts is asked alone.
        of_rows = design._replace(cell=cell[rows[padded_rows(len(rows))]])
        error = mass_errors(model, of_rows, of_kept, padded_impacts(u, 2), of_mass)
        return error[:, :, : len(rows)], of_errors

    impacts = _of_impacts(prepared, u, errors_and_keys, recorded=True, single=not whole)
    b, factor = population.b, dict[str, np.ndarray]()
    if log_factor is not None:
        log_gain = b[..., force_ratio(model.locations)] - log_factor if prepared.force else None
        b, factor = with_common_factor(prepared, b, log_factor, log_gain)
    effects = derived.effects_by_name(model.locations, prepared.design, b)
    numbers = None if whole else kept_numbers
    return Draws(population.hyperparameters | effects | factor, impacts, kept_numbers=numbers)


def prior_draws(prepared: Prepared, seed: int, rng: np.random.Generator, *, single: bool = False) -> Draws:
    """The same as the priors alone have it, of one chain; of impacts in ``single`` precision if so."""
    model, data = prepared.model, prepared.data
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 13)
    drawn, u = drawn_from_prior(model, data, key)
    factor: dict[str, np.ndarray] = {}
    if model.locations.of_shared_masses:
        error = np.asarray(shared_mass_errors(model.locations, data.design, jnp.asarray(drawn["locations"])))
    elif (common_sd := declared_common_sd(prepared)) is not None:
        error = np.broadcast_to(common_sd * rng.standard_normal(u.shape[:2])[..., None], u.shape[:-1])
        standard = np.asarray(jax.random.normal(jax.random.fold_in(key, 2), u.shape[:2]))
        log_gain = prepared.force.gain_sd * standard if prepared.force else None
        drawn["locations"], factor = with_common_factor(prepared, drawn["locations"], error[..., 0], log_gain)
    else:
        error = model.log_mass_sd * rng.standard_normal(u.shape[:-1])
    keys = np.asarray(jax.random.split(jax.random.fold_in(key, 1), u.shape[:2]))

    def errors_and_keys(rows: np.ndarray, u: np.ndarray) -> tuple[Any, Any]:
        return error[:, :, rows], keys

    impacts = _of_impacts(prepared, u, errors_and_keys, recorded=False, single=single)
    # The measuring chain's errors are as the dataset states them.
    impacts.pop("chain_error")
    effects = derived.effects_by_name(model.locations, prepared.design, drawn["locations"])
    return Draws({name: drawn[name] for name in model.hyperparameters} | effects | factor, impacts)


def quantities(prepared: Prepared, draws: Draws, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """All quantities by the names of ``posterior.nc``; ``rng`` is for those of a new impact."""
    design, population, impacts = prepared.design, draws.population, draws.impacts
    values = derived.formula_quantities(design, population)
    further = [which for name in prepared.model.nuisance for which in (f"{name}_mean", f"sd_{name}")]
    further += [MASS_FACTOR, GAIN_FACTOR]
    values |= {name: population[name] for name in further if name in population}
    levels = derived.level_quantities(design, values)
    values |= levels | {name: impacts[name] for name in NAMES if name in impacts}
    if "chain_error" in impacts:
        record = prepared.data.record
        known = prepared.error_sd.any(axis=0)
        known[-1] |= prepared.model.contact
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
        of_rows = u[:, :, rows]
        errors = errors_and_keys(rows, of_rows)
        drawn = drawn_impacts(prepared.model, part, recorded, of_rows, *errors)
        values = {name: np.moveaxis(array, 2, 0) for name, array in drawn.items()}
        # Half the memory.
        return {name: array.astype(np.float32) for name, array in values.items()} if single else values

    drawn = map_impacts(one, prepared.data, np.arange(u.shape[2]))
    return {name: np.moveaxis(values, 0, 2) for name, values in drawn.items()}


@padded(None, 2, 2, None)
@by_row(DRAWS, constant=3, axes=2)
def drawn_impacts(
    model: TraceModel,
    data: TraceData,
    recorded: bool,
    u: JaxPerParameter,
    mass_error: JaxPerImpact,
    key: Array,
) -> dict[str, Float[Array, "impact ..."]]:
    """Every impact's quantities, as what was recorded has them or the priors alone; compiled for both."""
    return impact_quantities(Impacts.drawn(model, data, list(u.T), mass_error, key, jnp.asarray(recorded)))


@padded(1, 1, None)
@by_row(DRAWS, constant=2)
def recorded_outcomes(
    model: TraceModel, data: TraceData, u: JaxPerParameter, mass_error: JaxPerImpact, key: Array
) -> dict[str, JaxPerImpact]:
    """The outcomes alone, given what was recorded: compiled sooner than `drawn_impacts` is."""
    impacts = Impacts.drawn(model, data, list(u.T), mass_error, key, jnp.asarray(True))
    return named_quantities(impacts, HEADFORM_OUTCOMES if model.headform else OUTCOMES)


def drawn_from_prior(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "chain draw impact parameter"]]:
    """One chain's hyperparameters, and effects as "locations"; impacts' parameters."""
    drawn = jax.device_get(_drawn_from_prior(model, data.padded, key))
    population, u = jax.tree.map(lambda values: values[None], drawn)
    return population, u[:, :, : len(data.log_mass)]


@compiled_quickly
def _drawn_from_prior(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[dict[str, Array], Float[Array, "draw impact parameter"]]:
    """The same, each [draw, ...]."""
    bare = Predictive(
        lambda: impacts_model(model, data),
        num_samples=PRIOR_DRAWS,
        return_sites=[*model.hyperparameters, "locations", "log_K_and_C", *model.nuisance],
    )
    drawn = bare(key)
    nuisance = [drawn.pop(name)[..., None] for name in model.nuisance]
    return drawn, jnp.concatenate([drawn.pop("log_K_and_C"), *nuisance], axis=-1)


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


def predicted(prepared: Prepared, draws: Draws, seed: int) -> dict[str, np.ndarray]:
    """About a hundred replicates of every trace, as what the likelihood is of."""
    u = draws.impacts["parameters"]
    u = u[:, :, some_impacts(u.shape[2])].astype(float)
    chains, length = u.shape[:2]
    u = u[:, :: max(1, chains * length // PREDICTIVE_DRAWS)]
    keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), 12), chains * u.shape[1])
    replicated = replicates(prepared.model, prepared.data, flat(u), keys)
    return in_chains({name: rounded(v) for name, v in replicated.items()}, u.shape[:2])


def rounded(replicates: Float[np.ndarray, "draw impact sample"]) -> Float[np.ndarray, "draw impact sample"]:
    """The same in steps that are powers of two and far below the noise, which a file packs well."""
    with warnings.catch_warnings():
        # Of a trace of NaN alone.
        warnings.simplefilter("ignore", RuntimeWarning)
        noise = np.nanmedian(np.std(np.diff(replicates, 2), axis=0), axis=-1, keepdims=True)
    step = np.exp2(np.floor(np.log2(np.where(noise > 0, noise, _NO_NOISE) / _STEPS)))
    return (np.round(replicates / step) * step).astype(np.float32)


def replicates(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "draw impact parameter"], keys: Array
) -> dict[str, Float[np.ndarray, "draw impact sample"]]:
    """A replicate of every trace for each draw of ``u``, as what the likelihood is of.

    That is the deceleration, and a force beside it; of a likelihood of displacements these, and the
    decelerations that follow.
    """
    samples = data.record.traces.shape[1]
    force = getattr(data.record, "force", None)
    ends = {} if force is None else {"force": force.y.shape[1]}
    replicated = _replicates(model, data, u, keys)
    return {name: values[..., : ends.get(name, samples)] for name, values in replicated.items()}


@padded(1, None)
@by_row(PREDICTIVE_DRAWS, constant=2)
def _replicates(
    model: TraceModel, data: TraceData, u: JaxPerParameter, key: Array
) -> dict[str, JaxPerSample]:
    """The same with as many samples as a `bayestissue.base.impact_arrays.bucket` holds."""
    replicate = trace_likelihood(model, data, list(u.T)).replicate(key)
    # Else the noise is made anew for every part of the row that is written: three times as long.
    return jax.lax.optimization_barrier(replicate)
