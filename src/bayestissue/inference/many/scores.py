"""Locations of many draws of the population, and the log densities that cross-validation needs."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.cell_solution import locations_of, solve
from bayestissue.hierarchy.gaussian.cell_sums import CellSums
from bayestissue.hierarchy.gaussian.cells import Cells, expected_by_place
from bayestissue.hierarchy.group_terms import stem_of
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.factors.laplace import ConditionalPrior
from bayestissue.inference.factors.moments import log_evidence
from bayestissue.inference.many.approximate import ManySummarised
from bayestissue.inference.many.correction import PopulationDraws, anchors_of, told_of_rows
from bayestissue.inference.many.kept import some_impacts, some_of
from bayestissue.inference.posterior.own_effects import OwnEffects, Slots, gained, own_effects
from bayestissue.inference.posterior.scores import LikelihoodApproximation, log_evidence_ratios

# Draws at a time: a thousand impacts' matrices take memory.
_AT_ONCE = 64


def locations_and_scores(
    prepared: Prepared, cells: Cells, raw: dict[str, Array], z: Float[Array, "draw location"]
) -> tuple[Float[Array, "draw location"], dict[str, Array]]:
    """All locations of each draw, and the log densities of all traces of each person and condition.

    Args:
        prepared: the fit.
        cells: the summaries by place.
        raw: the spreads' draws, unconstrained, [draw].
        z: standard normals of the locations.
    """
    found = own_effects(prepared.model, prepared.design)
    own = {name: _by_place(each, cells) for name, (_, each) in found.items()}
    slots = tuple((name, each) for name, (each, _) in found.items())
    return _population(prepared.model, slots, cells, own, raw, z)


def _by_place(own: OwnEffects, cells: Cells) -> OwnEffects:
    """The same of each place, whose impacts are alike; an empty one has level 0 and adds nothing."""
    place, places = np.asarray(cells.arrangement.place), cells.level.shape[0]
    level, value = np.zeros(places, int), np.zeros((len(own.value), places))
    level[place], value[:, place] = own.level, own.value
    return OwnEffects(level, own.element, value)


@partial(jax.jit, static_argnames="slots")
def _population(
    model: TraceModel,
    slots: tuple[tuple[str, Slots], ...],
    cells: Cells,
    own: dict[str, OwnEffects],
    raw: dict[str, Array],
    z: Array,
) -> tuple[Array, dict[str, Array]]:
    """All locations of each draw, and the log densities of all traces of each person and condition."""

    def one(draw: tuple[dict[str, Array], Array]) -> tuple[Array, dict[str, Array]]:
        sites = constrained(model, draw[0])
        solution, sums = solve(cells, population(model, sites))
        b = locations_of(cells, solution, draw[1])
        return b, _scores(model, slots, cells, sums, own, sites, b)

    return jax.lax.map(one, (raw, z))


def _scores(
    model: TraceModel,
    slots_of: tuple[tuple[str, Slots], ...],
    cells: Cells,
    sums: CellSums,
    own_of: dict[str, OwnEffects],
    sites: dict[str, Array],
    b: Array,
) -> dict[str, Array]:
    """Log densities of all traces together, and of a person's or a condition's with its effects left out."""
    size = len(cells.slope)
    here = expected_by_place(cells.arrangement, b)[:size]
    start = expected_by_place(cells.arrangement, cells.reference)[:size]
    moved = [v - v0 for v, v0 in zip(here, start, strict=True)]

    def at(away: list[Array]) -> tuple[Array, list[Array]]:
        bent = [sum(sums.entry(a, c) * away[c] for c in range(size)) for a in range(size)]
        value = cells.level + sums.constant
        value = value + sum(d * (sums.pull[a] - bent[a] / 2) for a, d in enumerate(away))
        return value, [sums.pull[a] - bent[a] for a in range(size)]

    scores = {"traces": at(moved)[0].sum()}
    for name, slots in slots_of:
        own = own_of[name]
        levels, of = own.element.shape[1], slots.response
        away = [d - own.in_impacts(slots, b, a) if a < 2 else d for a, d in enumerate(moved)]
        value, pull = at(away)

        def total(values: Array, own: OwnEffects = own, levels: int = levels) -> Array:
            return jax.ops.segment_sum(values, own.level, levels)

        weight = {
            (s, t): total(sums.entry(of[s], of[t]) * (own.value[s] * own.value[t])) for s, t in slots.together
        }
        score = [total(pull[a] * value) for a, value in zip(of, own.value, strict=True)]
        if score:
            added = gained(model, slots, sites, weight, score)
            scores[f"traces_of_{stem_of(name)}"] = total(value) + added
    return scores


def scores_of_some(
    prepared: Prepared, summarised: ManySummarised, draws: PopulationDraws
) -> Float[np.ndarray, "draw shown"]:
    """Log density of the traces of some impacts, every draw."""
    rows = some_impacts(len(prepared.data.log_mass))
    place = np.asarray(summarised.cells.arrangement.place)[rows]
    anchors = anchors_of(prepared.model, summarised.cells, draws, place)
    told = LikelihoodApproximation(*told_of_rows(summarised.summaries, summarised.profile, rows))
    besides = log_evidence_ratios(prepared.model, some_of(prepared, rows).data, told, anchors)
    at_once = [
        ConditionalPrior(*(part[begin : begin + _AT_ONCE] for part in anchors)) for begin in _begins(besides)
    ]
    return besides + np.concatenate([log_evidence(told.summaries, part) for part in at_once])


def _begins(rows: np.ndarray) -> range:
    return range(0, len(rows), _AT_ONCE)
