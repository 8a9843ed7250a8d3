"""From draws of the population and of impacts' parameters to all that they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.derived import named_sites
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.population import of_impacts
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, population
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.execution.compiling import by_row
from bayestissue.inference.factors.conditional import PopulationDraws, of_cells
from bayestissue.inference.quantities.draws import DRAWS, constrained_impacts
from bayestissue.inference.samplers.sampling import ConstrainedDraws
from bayestissue.padding import padded_impacts, padded_rows


def _kept(
    population: PopulationDraws, shape: tuple[int, int], kept_numbers: np.ndarray
) -> tuple[PopulationDraws, np.ndarray]:
    """Of the population the draws that are kept of impacts, and which of all these are."""
    which = (np.arange(shape[0])[:, None] * shape[1] + kept_numbers).ravel()
    return population.rows(which), which


def quantities_of_draws(
    prepared: Prepared,
    population: PopulationDraws,
    impacts_u: Float[np.ndarray, "draw impact parameter"],
    shape: tuple[int, int],
    kept_numbers: Int[np.ndarray, " kept"],
    key: Array,
    scores: dict[str, np.ndarray],
) -> ConstrainedDraws:
    """Everything that draws of the population and of impacts' parameters stand for.

    Args:
        prepared: the fit.
        population: all chains' draws, one chain's after the other's.
        impacts_u: parameters of every impact, of the draws that are kept.
        shape: the numbers of chains and of draws of each.
        kept_numbers: of the draws of each chain that are kept of impacts.
        key: of what is drawn besides.
        scores: log densities of the traces, see `of_draws`.
    """
    model, design = prepared.model, prepared.data.design
    cell = np.asarray(design.cell)
    # In numpy: jax compiles each step of choosing some of them anew for every number of draws.
    keys = np.asarray(jax.random.split(jax.random.fold_in(key, 11), len(population.b)))
    kept_population, which = _kept(population, shape, kept_numbers)
    people = keys[which]
    priors = kept_population.priors(design)

    def one(part: TraceData, rows: np.ndarray) -> dict[str, np.ndarray]:
        here, u = of_cells(priors, cell[rows]), impacts_u[:, rows]
        of_block = jax.vmap(partial(jax.random.fold_in, data=rows[0]))(people)
        of_errors, of_mass = np.moveaxis(np.asarray(jax.vmap(jax.random.split)(of_block)), 1, 0)
        shared = people if model.mass_error == "subject" else of_mass
        # Of the design X b of these impacts is asked alone.
        of_rows = design._replace(cell=cell[rows[padded_rows(len(rows))]])
        mean, u = padded_impacts((here.mean, u), 1)
        mass_error = _mass_errors(model, of_rows, kept_population.sites, kept_population.b, mean, u, shared)
        padded = constrained_impacts(model, part.padded, True, u, mass_error, of_errors)
        impacts_by_name = {name: values[:, : len(rows)] for name, values in padded.items()}
        if len(kept_numbers) < shape[1]:
            # Seven digits of a draw are more than it knows, and half the memory.
            impacts_by_name = {name: values.astype(np.float32) for name, values in impacts_by_name.items()}
        return {name: np.moveaxis(values, 1, 0) for name, values in impacts_by_name.items()}

    impacts_by_name = in_blocks(prepared.data, one)
    impacts = {
        name: np.moveaxis(v.reshape(len(v), shape[0], len(kept_numbers), *v.shape[2:]), 0, 2)
        for name, v in impacts_by_name.items()
    }
    b = _at_true_masses(model, population.sites, population.b, keys)
    values, b, scores = jax.tree.map(
        lambda v: np.asarray(v).reshape(*shape, *v.shape[1:]), (population.sites, b, scores)
    )
    named = named_sites(model.locations, prepared.design, values, b)
    return ConstrainedDraws(named, impacts, scores, None if len(kept_numbers) == shape[1] else kept_numbers)


@by_row(DRAWS, constant=2)
def _mass_errors(
    model: TraceModel,
    design: PopulationDesign,
    sites: dict[str, Array],
    b: Float[Array, " location"],
    prior_mean: Float[Array, "impact parameter"],
    u: Float[Array, "impact parameter"],
    key: Array,
) -> Float[Array, " impact"]:
    """The error of every impact's log mass."""
    covariances = population(model, sites)
    if covariances.shared is not None:
        return of_impacts(design, covariances, error_of_people(covariances, b, key))
    pair = [entry - model.log_mass_sd**2 for entry in covariances.pair]
    return error_given(model.log_mass_sd**2, pair, (u - prior_mean).T, key)


@by_row(DRAWS, constant=1)
def _at_true_masses(
    model: TraceModel, sites: dict[str, Array], b: Float[Array, " location"], key: Array
) -> Float[Array, " location"]:
    """People's effects in b put at their true mass."""
    covariances = population(model, sites)
    if covariances.shared is None:
        return b
    error = error_of_people(covariances, b, key)
    return b.at[covariances.shared.effect_on_K].add(error).at[covariances.shared.effect_on_C].add(error)


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
