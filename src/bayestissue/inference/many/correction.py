"""The correction of `ratios` for many impacts: expanded to second order in the population.

What a trace's true evidence adds to its summary's is a smooth function of what the population says of the
impact. Small as it is for one trace, over many it adds up to more than weights could put right. But with many
impacts the posterior of the population is narrow beside the scatter of the impacts, which is the scale on
which these functions bend: their expansions about the posterior's middle, added up cell by cell, go into the
evidence itself. What even these leave out is made whole at some draws of the posterior, and tells whether the
draws can be trusted.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.gaussian.cell_sums import flat_spreads
from bayestissue.hierarchy.gaussian.cells import Cells, Expansion, expected_by_place
from bayestissue.hierarchy.gaussian.conditional import Sites, impact_parts, prior_precision
from bayestissue.hierarchy.population import Covariances
from bayestissue.hierarchy.traces import TraceData, TraceModel, constrained, population
from bayestissue.inference.execution.chunks import in_blocks
from bayestissue.inference.factors.grid import LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    ImportanceRatios,
    importance_ratios,
    log_corrections,
)
from bayestissue.inference.factors.laplace import ConditionalPrior
from bayestissue.inference.factors.moments import standard_points
from bayestissue.inference.samplers.sampling import Progress, silent


class PopulationDraws(NamedTuple):
    """Draws of the population: the spreads, unconstrained, and the locations."""

    raw: dict[str, Float[Array, " draw"]]
    b: Float[Array, "draw location"]

    def some(self, number: int) -> PopulationDraws:
        """As many of them, evenly spaced."""
        chosen = np.linspace(0, len(self.b) - 1, number).astype(int)
        return PopulationDraws({name: values[chosen] for name, values in self.raw.items()}, self.b[chosen])


def rows_of(summaries: Sites, rows: np.ndarray) -> Sites:
    """Some impacts' summaries."""
    return Sites(*(np.asarray(leaf)[rows] for leaf in summaries))


def expand(
    model: TraceModel,
    data: TraceData,
    summaries: Sites,
    profile: LikelihoodGrid | None,
    cells: Cells,
    spread: Covariances,
    draws: PopulationDraws,
    *,
    progress: Progress = silent,
) -> Expansion:
    """The expansion about the cells' reference and these spreads.

    Args:
        model: the model.
        data: the traces.
        summaries: of them.
        profile: of their last parameter, if it has one.
        cells: the summaries by place.
        spread: about which to expand.
        draws: of the population, as many as there are points: where traces and summaries are compared.
        progress: told how many blocks of impacts are done.
    """
    size = len(cells.slope)
    at = flat_spreads(spread, size)
    centre = [np.asarray(each) for each in expected_by_place(cells.arrangement, cells.reference)[:size]]
    mixture = _by_place(model, cells, draws)
    standard = standard_points(summaries.centre.shape[1])
    place = np.asarray(cells.arrangement.place)

    def one(part: TraceData, rows: np.ndarray) -> tuple[Array, Array]:
        here = np.stack([each[place[rows]] for each in centre], axis=-1)
        middle = np.concatenate([here, np.broadcast_to(np.asarray(at), (len(rows), len(at)))], axis=1)
        own, own_profile = told_of_rows(summaries, profile, rows)
        anchors = _anchors(*_at_places(mixture, place[rows]))
        return _expand(own, importance_ratios(model, part, own, anchors, standard, own_profile), middle)

    slope, bend = in_blocks(data, one, progress=progress)
    places = cells.level.shape[0]
    return Expansion(
        at,
        jax.ops.segment_sum(jnp.asarray(slope), place, places),
        jax.ops.segment_sum(jnp.asarray(bend), place, places),
    )


def residual_log_weights(
    model: TraceModel,
    data: TraceData,
    summaries: Sites,
    profile: LikelihoodGrid | None,
    cells: Cells,
    mixture: PopulationDraws,
    checked: PopulationDraws,
    *,
    progress: Progress = silent,
) -> Float[np.ndarray, " draw"]:
    """Log of the true evidence over the one that draws were made with, for some draws, less their mean.

    Args:
        model: the model.
        data: the traces.
        summaries: of them.
        profile: of their last parameter, if it has one.
        cells: the summaries by place, with the expansion.
        progress: told how many blocks of impacts are done.
        mixture: draws of the population at which traces and summaries are compared.
        checked: the draws to check.
    """
    size, place = len(cells.slope), np.asarray(cells.arrangement.place)
    standard = standard_points(summaries.centre.shape[1])
    compared, seen = _by_place(model, cells, mixture), _by_place(model, cells, checked)

    def one(part: TraceData, rows: np.ndarray) -> Array:
        own, own_profile = told_of_rows(summaries, profile, rows)
        anchors = _anchors(*_at_places(compared, place[rows]))
        points = importance_ratios(model, part, own, anchors, standard, own_profile)
        return _corrections(own, points, _at_places(seen, place[rows]))

    exact = in_blocks(data, one, progress=progress).sum(0)
    expanded = 0.0 if cells.expansion is None else np.asarray(_expanded(cells, *seen, size))
    return (exact - expanded) - (exact - expanded).mean()


def anchors_of(
    model: TraceModel, cells: Cells, draws: PopulationDraws, place: Int[np.ndarray, " impact"]
) -> ConditionalPrior:
    """What draws of the population expect of the impacts at some places."""
    return _anchors(*_at_places(_by_place(model, cells, draws), place))


ByPlace = tuple[Covariances, list[Any]]


def _by_place(model: TraceModel, cells: Cells, draws: PopulationDraws) -> ByPlace:
    spread = jax.vmap(lambda raw: population(model, constrained(model, raw))._replace(shared=None))(draws.raw)
    return spread, [np.asarray(each) for each in expected_by_place(cells.arrangement, draws.b)]


def _at_places(draws: ByPlace, place: np.ndarray) -> ByPlace:
    spread, about = draws
    return spread._replace(locations=jnp.zeros((len(about[0]), 0))), [each[:, place] for each in about]


def _anchors(spread: Covariances, about: list[Any]) -> ConditionalPrior:
    """What the same draws expect of every impact, as numpy arrays."""
    rows = [np.stack([np.asarray(entry) for entry in row], axis=-1) for row in prior_precision(spread)]
    return ConditionalPrior(np.stack(about, axis=-1), np.stack(rows, axis=-2)[:, None])


def told_of_rows(
    summaries: Sites, profile: LikelihoodGrid | None, rows: np.ndarray
) -> tuple[Sites, LikelihoodGrid | None]:
    """Some impacts' summaries, and their profile if there is one."""
    own = rows_of(summaries, rows)
    if profile is None:
        return own, None
    return own, profile._replace(log_likelihood=jnp.asarray(np.asarray(profile.log_likelihood)[:, rows]))


@partial(jax.jit, static_argnames="size")
def _expanded(cells: Cells, spread: Covariances, about: list[Array], size: int) -> Array:
    """The expansion's value at some draws, but for a constant."""
    start = expected_by_place(cells.arrangement, cells.reference)[:size]
    expansion = cells.expansion
    assert expansion is not None  # noqa: S101 - the one caller has it

    def one(draw: tuple[Array, list[Array]]) -> Array:
        spreads, here = draw
        moved = jnp.stack([v - v0 for v, v0 in zip(here[:size], start, strict=True)], axis=-1)
        common = jnp.broadcast_to(spreads - expansion.spreads, (len(moved), len(spreads)))
        away = jnp.concatenate([moved, common], axis=1)
        return (away * (expansion.slope + jnp.einsum("pvw,pw->pv", expansion.bend, away) / 2)).sum()

    return jax.lax.map(one, (flat_spreads(spread, size), about))


@jax.jit
def _expand(
    summaries: Sites, points: ImportanceRatios, middle: Float[Array, "impact v"]
) -> tuple[Array, Array]:
    """Slopes and bends of each impact's correction at the middle."""
    slope = jax.grad(lambda v: _correction(points, summaries, v).sum())

    def bent(direction: Array) -> Array:
        return jax.jvp(slope, (middle,), (jnp.broadcast_to(direction, middle.shape),))[1]

    return slope(middle), jax.lax.map(bent, jnp.eye(middle.shape[1])).transpose(1, 2, 0)


@jax.jit
def _corrections(summaries: Sites, points: ImportanceRatios, seen: ByPlace) -> Array:
    """Each impact's correction at some draws, [impact, draw]."""
    size = points.u.shape[-1]

    def one(draw: tuple[Array, list[Array]]) -> Array:
        spreads, about = draw
        here = jnp.stack(about[:size], axis=-1)
        return _correction(
            points,
            summaries,
            jnp.concatenate([here, jnp.broadcast_to(spreads, (len(here), len(spreads)))], axis=1),
        )

    return jax.lax.map(one, (flat_spreads(seen[0], size), seen[1])).T


def _correction(points: ImportanceRatios, summaries: Sites, v: Array) -> Array:
    """Each impact's correction, as a function of what the population says of it."""
    size = points.u.shape[-1]
    known = Sites(
        summaries.centre[:, :size],
        summaries.slope[:, :size],
        summaries.precision[:, :size, :size],
        summaries.log_likelihood,
    )
    about = [v[:, a] for a in range(size)]
    own = (v[:, size], v[:, size + 1], v[:, size + 2])
    nuisance = tuple(jnp.sqrt(v[:, size + 3 + k]) for k in range(size - 2))
    parts = impact_parts(Covariances(own, nuisance, jnp.zeros(0)), known)
    return log_corrections(points, known, parts.prior, about)
