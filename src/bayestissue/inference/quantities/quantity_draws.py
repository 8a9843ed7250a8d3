"""From draws of hyperparameters, effects and impacts to all quantities, of posterior and prior alike.

Also by how much declared masses are wrong in each draw (one by one, several together, or all by one factor),
and replicates of every trace.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpyro.infer import Predictive

from bayestissue.base.impact_arrays import (
    JaxPerImpact,
    JaxPerParameter,
    JaxPerSample,
    PerDraw,
    padded_rows,
)
from bayestissue.base.outcome_table import HEADFORM_OUTCOMES, OUTCOMES
from bayestissue.inference.chain.results import ChainDraws
from bayestissue.inference.execution.chunks import map_impacts
from bayestissue.inference.execution.compiling import by_row, compiled_quickly, padded
from bayestissue.inference.execution.kept import all_kept, kept_draws, some_impacts
from bayestissue.inference.factors.scores import log_densities
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


def posterior_draws(prepared: Prepared, chains: ChainDraws, seed: int) -> Draws:
    """Everything that the draws of a fit's chains stand for, its scores too.

    Args:
        prepared: the fit.
        chains: its draws.
        seed: of what is drawn besides: the measuring chain's errors, and those of mass.
    """
    population, count, key = chains.population, len(prepared.impacts), jax.random.PRNGKey(seed)
    scores = log_densities(prepared, chains.sites, population, chains.log_ratios, some_impacts(count))
    # In numpy: jax compiles each step of choosing some of them anew for every number of draws.
    keys = np.asarray(jax.random.split(jax.random.fold_in(key, 11), chains.shape))
    logs = common_logs(prepared, population.b, jax.random.fold_in(key, 12), recorded=True)
    chosen, whole = kept_draws(chains.shape[0], len(chains.impact_draws), count), all_kept(count)
    numbers, u = chains.impact_draws[chosen], chains.u[:, chosen]
    of_kept = jax.tree.map(lambda values: values[:, numbers], (population, logs, keys))
    impacts = _of_impacts(prepared, u, *of_kept, recorded=True, single=not whole)
    by_name = population_by_name(prepared, population, logs)
    return Draws(by_name, impacts, scores, None if whole else numbers)


def prior_draws(prepared: Prepared, seed: int, *, single: bool = False) -> Draws:
    """The same as the priors alone have it, of one chain; of impacts in ``single`` precision if so."""
    key = jax.random.fold_in(jax.random.PRNGKey(seed), 13)
    population, u = drawn_from_prior(prepared.model, prepared.data, key)
    keys = np.asarray(jax.random.split(jax.random.fold_in(key, 1), u.shape[:2]))
    logs = common_logs(prepared, population.b, jax.random.fold_in(key, 2), recorded=False)
    impacts = _of_impacts(prepared, u, population, logs, keys, recorded=False, single=single)
    # The measuring chain's errors are as the dataset states them.
    impacts.pop("chain_error")
    return Draws(population_by_name(prepared, population, logs), impacts)


def population_by_name(
    prepared: Prepared, population: Population, logs: Mapping[str, PerDraw]
) -> dict[str, np.ndarray]:
    """Hyperparameters, effects at the true masses, and the factors whose ``logs`` `common_logs` has.

    K, C and any mass of the element go with all masses.
    """
    model, b = prepared.model, population.b
    if logs:
        b = heavier(model.locations, b, logs[MASS_FACTOR], in_proportion_to_mass(model.element))
    factors = {name: np.exp(values) for name, values in logs.items()}
    effects = derived.effects_by_name(model.locations, prepared.design, b)
    return population.hyperparameters | effects | factors


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


def _of_impacts(
    prepared: Prepared,
    u: Float[np.ndarray, "chain draw impact parameter"],
    population: Population,
    logs: Mapping[str, PerDraw],
    keys: np.ndarray,
    *,
    recorded: bool,
    single: bool,
) -> dict[str, Float[np.ndarray, "chain draw impact ..."]]:
    """What `impact_quantities` has of every impact, block by block, in ``single`` precision if so."""
    model, design, force = prepared.model, prepared.data.design, prepared.force
    cell, ratio = np.asarray(design.cell), population.b[..., force_ratio(model.locations)]

    def block(part: TraceData, rows: np.ndarray) -> dict[str, np.ndarray]:
        of_rows, error = u[:, :, rows], logs.get(MASS_FACTOR)
        if error is not None:
            error = np.broadcast_to(error[..., None], of_rows.shape[:-1])
            if recorded and force and force.share:
                # What an impact's own mass errs by besides, by a force's ratio to its mean.
                error = error + of_rows[..., -1] - ratio[..., None]
        # Of the design X b of these impacts is asked alone.
        arranged = design._replace(cell=cell[rows[padded_rows(len(rows))]])
        drawn = of_draw(model, part, arranged, recorded, rows[0], population, of_rows, error, keys)
        values = {name: np.moveaxis(array, 2, 0) for name, array in drawn.items()}
        # Half the memory.
        return {name: array.astype(np.float32) for name, array in values.items()} if single else values

    drawn = map_impacts(block, prepared.data, np.arange(u.shape[2]))
    return {name: np.moveaxis(values, 0, 2) for name, values in drawn.items()}


@padded(None, None, None, None, 2, 2, None)
@by_row(DRAWS, constant=5, axes=2)
def of_draw(
    model: TraceModel,
    data: TraceData,
    design: PopulationDesign,
    recorded: bool,
    first: int,
    population: Population,
    u: JaxPerParameter,
    mass_error: JaxPerImpact | None,
    key: Array,
) -> dict[str, Float[Array, "impact ..."]]:
    """Every quantity of the impacts of a block in one draw, as what was recorded has it or the priors alone.

    Args:
        model: what is assumed.
        data: the recordings.
        design: of these impacts.
        recorded: whether it is given what was recorded.
        first: number of the block's first impact, by which its random numbers differ from others'.
        population: hyperparameters and effects.
        u: the impacts' parameters, at the recorded masses.
        mass_error: of their log masses, if it is that of all; else it is part of b, or drawn given u.
        key: of the measuring chain's errors and of mass_error.
    """
    of_errors, of_mass = jax.random.split(jax.random.fold_in(key, first))
    if model.locations.of_shared_masses:
        mass_error = shared_mass_errors(model.locations, design, population.b)
    elif mass_error is None:
        variance, covariances = model.log_mass_sd**2, model.covariances(population.hyperparameters)
        deviation = u.T - expected(design, population.b)
        pair = [entry - variance for entry in covariances.pair]
        mass_error = error_given(variance, pair, deviation, of_mass)
    impacts = Impacts.drawn(model, data, list(u.T), mass_error, of_errors, jnp.asarray(recorded))
    return impact_quantities(impacts)


@padded(1, 1, None)
@by_row(DRAWS, constant=2)
def recorded_outcomes(
    model: TraceModel, data: TraceData, u: JaxPerParameter, mass_error: JaxPerImpact, key: Array
) -> dict[str, JaxPerImpact]:
    """The outcomes alone, given what was recorded: compiled sooner than `of_draw` is."""
    impacts = Impacts.drawn(model, data, list(u.T), mass_error, key, jnp.asarray(True))
    return named_quantities(impacts, HEADFORM_OUTCOMES if model.headform else OUTCOMES)


def drawn_from_prior(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[Population, Float[np.ndarray, "chain draw impact parameter"]]:
    """One chain's hyperparameters and effects, and the impacts' parameters."""
    drawn = jax.device_get(_drawn_from_prior(model, data.padded, key))
    population, u = jax.tree.map(lambda values: values[None], drawn)
    return population, u[:, :, : len(data.log_mass)]


@compiled_quickly
def _drawn_from_prior(
    model: TraceModel, data: TraceData, key: Array
) -> tuple[Population, Float[Array, "draw impact parameter"]]:
    """The same, each [draw, ...]."""
    bare = Predictive(
        lambda: impacts_model(model, data),
        num_samples=PRIOR_DRAWS,
        return_sites=[*model.hyperparameters, "locations", "log_K_and_C", *model.nuisance],
    )
    drawn = bare(key)
    u = jnp.concatenate([drawn["log_K_and_C"], *(drawn[name][..., None] for name in model.nuisance)], axis=-1)
    return Population({name: drawn[name] for name in model.hyperparameters}, drawn["locations"]), u


def common_logs(
    prepared: Prepared, b: Float[np.ndarray, "chain draw location"], key: Array, *, recorded: bool
) -> dict[str, PerDraw]:
    """Logs of what all masses, K and C with them, and both gains beside a force are to be multiplied by.

    None where each mass errs by itself. A force beside the deceleration tells both, phantoms of known
    stiffness that of the masses; else, and before anything is ``recorded``, they are as declared.
    """
    force, reference = prepared.force, prepared.reference
    known = force or reference
    mass_sd = prepared.common_mass_sd or None if known is None else known.mass_sd
    if mass_sd is None:
        return {}
    standard = np.asarray(jax.random.normal(key, b.shape[:2]))
    if force is not None and recorded:
        ratio = b[..., force_ratio(prepared.model.locations)]
        of_mass = force.log_mass_factor(ratio, standard)
        return {MASS_FACTOR: of_mass, GAIN_FACTOR: ratio - of_mass}
    if reference is not None and recorded:
        return {MASS_FACTOR: reference.log_mean + reference.log_sd * standard}
    logs = {MASS_FACTOR: mass_sd * standard}
    if force is not None:
        of_gain = np.asarray(jax.random.normal(jax.random.fold_in(key, 1), b.shape[:2]))
        logs[GAIN_FACTOR] = force.gain_sd * of_gain
    return logs


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
