"""From draws of hyperparameters, effects and impacts to all quantities, of posterior and prior alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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

from bayestissue.base.arrays import JaxPerImpact, JaxPerParameter
from bayestissue.base.outcomes import HEADFORM_OUTCOMES, OUTCOMES
from bayestissue.base.padding import padded_impacts, padded_rows
from bayestissue.inference.execution.chunks import map_impacts
from bayestissue.inference.execution.compiling import by_row, compiled_quickly, padded
from bayestissue.inference.execution.kept import all_kept
from bayestissue.inference.quantities.impact_quantities import (
    NAMES,
    Impacts,
    impact_quantities,
    named_quantities,
)
from bayestissue.inference.quantities.mass_errors import (
    DRAWS,
    GAIN_FACTOR,
    MASS_FACTOR,
    common_log_factor,
    declared_common_sd,
    mass_errors,
    with_common_factor,
)
from bayestissue.model.hierarchy import derived
from bayestissue.model.hierarchy.population import Population, force_ratio, shared_mass_errors
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import TraceData, TraceModel, impacts_model

PRIOR_DRAWS = 1000
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
