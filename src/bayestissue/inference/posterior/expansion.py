"""Log evidence ratios of many impacts, expanded to second order in the population.

What a trace's true evidence adds to its summary's is a smooth function of what the population says of the
impact. Small as it is for one trace, over many it adds up to more than weights could put right. But with many
impacts the posterior of the population is narrow beside the scatter of the impacts, which is the scale on
which these functions bend: their expansions about the posterior's middle, added up cell by cell, go into the
evidence itself. What even these leave out is made whole at some draws of the posterior, and tells whether the
draws can be trusted.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, expected_by_cell
from bayestissue.hierarchy.gaussian.conditional import Expansion, flat_spreads
from bayestissue.hierarchy.gaussian.covariances import Covariances
from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceData, TraceModel, constrained, population
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.execution.progress import Progress, silent
from bayestissue.inference.factors.conditional import ConditionalPrior, evenly_spaced
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    log_corrections,
    log_evidence_corrections,
    ratios_among,
)
from bayestissue.inference.posterior.approximate import Approximation
from bayestissue.inference.samplers.psis import relative_variance


class PopulationDraws(NamedTuple):
    """Draws of the population: the spreads, unconstrained, and the locations."""

    raw: dict[str, Float[Array, " draw"]]
    b: Float[Array, "draw location"]

    def rows(self, chosen: Any) -> PopulationDraws:
        """Some of them."""
        return PopulationDraws({name: values[chosen] for name, values in self.raw.items()}, self.b[chosen])

    def some(self, number: int) -> PopulationDraws:
        """As many of them, evenly spaced."""
        return self.rows(evenly_spaced(len(self.b), number))


def rows_of(summaries: Sites, rows: np.ndarray) -> Sites:
    """Some impacts' summaries."""
    return Sites(*(np.asarray(leaf)[rows] for leaf in summaries))


def expand(
    prepared: Prepared,
    sites: Approximation,
    middle: PopulationDraws,
    draws: PopulationDraws,
    *,
    progress: Progress = silent,
) -> Expansion:
    """The expansion about one population.

    Args:
        prepared: model and data.
        sites: of the traces.
        middle: one draw of the population, about which to expand.
        draws: of the population, as many as there are points: where traces and sites are compared.
        progress: told how many blocks of impacts are done.
    """
    model, data = prepared.model, prepared.data
    design, cell = data.design, np.asarray(data.design.cell)
    at, about = (np.asarray(part)[0] for part in _seen(model, design, middle))
    mixture = anchors_of(model, design, draws)

    def one(part: TraceData, rows: np.ndarray) -> tuple[Array, Array]:
        here = np.concatenate([about[cell[rows]], np.broadcast_to(at, (len(rows), len(at)))], axis=1)
        own, grid = told_of_rows(sites, rows)
        return _expand(own, ratios_among(model, part, own, of_cells(mixture, cell[rows]), grid), here)

    slope, bend = in_blocks(data, one, progress=progress)
    return Expansion(
        jnp.asarray(about.T),
        jnp.asarray(at),
        design.to_cells(jnp.asarray(np.moveaxis(slope, 0, -1))),
        design.to_cells(jnp.asarray(np.moveaxis(bend, 0, -1))),
    )


def residual_log_weights(
    prepared: Prepared,
    sites: Approximation,
    mixture: PopulationDraws,
    checked: PopulationDraws,
    *,
    progress: Progress = silent,
) -> tuple[Float[np.ndarray, " draw"], Float[np.ndarray, " impact"]]:
    """Log of the true evidence over the one that draws were made with, for some draws, less their mean.

    And the relative variance of each impact's likelihood over its site.

    Args:
        prepared: model and data.
        sites: of the traces, with what they leave out expanded where that is part of the density.
        mixture: draws of the population at which traces and sites are compared.
        checked: the draws to check.
        progress: told how many blocks of impacts are done.
    """
    model, data = prepared.model, prepared.data
    cell = np.asarray(data.design.cell)
    compared, seen = (anchors_of(model, data.design, draws) for draws in (mixture, checked))

    def one(part: TraceData, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own, grid = told_of_rows(sites, rows)
        points = ratios_among(model, part, own, of_cells(compared, cell[rows]), grid)
        found = log_evidence_corrections(own, points, of_cells(seen, cell[rows]))
        return found.T, relative_variance(points.log_ratio)

    each, varies = in_blocks(data, one, progress=progress)
    exact = each.sum(0)
    if sites.expansion is not None:
        exact = exact - np.asarray(_expanded(model, data.design, sites.expansion, checked))
    return exact - exact.mean(), varies


def anchors_of(model: TraceModel, design: PopulationDesign, draws: PopulationDraws) -> ConditionalPrior:
    """What draws of the population expect of the impacts at every place."""
    precision = jax.vmap(lambda raw: population(model, constrained(model, raw)).of_impact().precision)
    _, about = _seen(model, design, draws)
    return ConditionalPrior(np.asarray(about), np.asarray(precision(draws.raw))[:, None])


def of_cells(anchors: ConditionalPrior, cell: np.ndarray) -> ConditionalPrior:
    """The same of impacts in these places."""
    return anchors._replace(mean=anchors.mean[:, cell])


def _seen(
    model: TraceModel, design: PopulationDesign, draws: PopulationDraws
) -> tuple[Float[Array, "draw spread"], Float[Array, "draw place parameter"]]:
    """The two parts of v of each draw."""
    spreads = jax.vmap(lambda raw: flat_spreads(population(model, constrained(model, raw))))(draws.raw)
    return spreads, jnp.moveaxis(expected_by_cell(design, draws.b), 0, -1)


def told_of_rows(sites: Approximation, rows: np.ndarray) -> tuple[Sites, LikelihoodGrid | None]:
    """Some impacts' sites, and their grid of the last parameter if there is one."""
    own, grid = rows_of(sites.summaries, rows), sites.profile
    if grid is None:
        return own, None
    return own, grid._replace(log_likelihood=jnp.asarray(np.asarray(grid.log_likelihood)[:, rows]))


@jax.jit
def _expanded(
    model: TraceModel, design: PopulationDesign, expansion: Expansion, draws: PopulationDraws
) -> Array:
    """The expansion's value at some draws, but for a constant."""

    def one(draw: tuple[dict[str, Array], Array]) -> Array:
        covariances = population(model, constrained(model, draw[0]))
        return expansion.value(expected_by_cell(design, draw[1]), covariances).sum()

    return jax.lax.map(one, (draws.raw, draws.b))


@jax.jit
def _expand(
    summaries: Sites, points: ImportanceRatios, middle: Float[Array, "impact v"]
) -> tuple[Array, Array]:
    """Slopes and bends of each impact's correction at the middle."""
    slope = jax.grad(lambda v: _correction(points, summaries, v).sum())

    def bent(direction: Array) -> Array:
        return jax.jvp(slope, (middle,), (jnp.broadcast_to(direction, middle.shape),))[1]

    return slope(middle), jax.lax.map(bent, jnp.eye(middle.shape[1])).transpose(1, 2, 0)


def _correction(points: ImportanceRatios, summaries: Sites, v: Array) -> Array:
    """Each impact's correction, as a function of what the population says of it."""
    size = summaries.centre.shape[1]
    kk, kc, cc = v[:, size : size + 3].T
    prior = Covariances((kk, kc, cc), tuple(jnp.sqrt(v[:, size + 3 :]).T), jnp.zeros(0)).of_impact()
    precision = jnp.moveaxis(prior.precision, -1, 0)
    return log_corrections(points, summaries, ConditionalPrior(v[:, :size], precision))
