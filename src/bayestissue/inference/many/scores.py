"""Locations of many draws of the population, and the log densities that cross-validation needs."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.gaussian.cell_solution import locations_of, solve
from bayestissue.hierarchy.gaussian.cell_sums import CellSums
from bayestissue.hierarchy.gaussian.cells import Cells, expected_by_place
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import TraceModel, constrained, population
from bayestissue.inference.factors.laplace import ConditionalPrior
from bayestissue.inference.factors.moments import log_evidence
from bayestissue.inference.many.approximate import ManySummarised
from bayestissue.inference.posterior.correction import PopulationDraws, anchors_of, told_of_rows
from bayestissue.inference.execution.kept import some_impacts, some_of
from bayestissue.inference.posterior.scores import (
    LikelihoodApproximation,
    integrated_effects,
    log_evidence_ratios,
)

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
    return _population(prepared.model, cells, _codes(prepared, cells), raw, z)


def _codes(prepared: Prepared, cells: Cells) -> dict[str, Int[np.ndarray, " place"]]:
    """Person and condition of each place; 0 for an empty one, which adds nothing."""
    place = np.asarray(cells.arrangement.place)
    codes = {}
    for group in GROUPS:
        codes[group] = np.zeros(cells.level.shape[0], int)
        codes[group][place] = getattr(prepared.design, group)
    return codes


@partial(jax.jit, static_argnames="model")
def _population(
    model: TraceModel, cells: Cells, codes: dict[str, Array], raw: dict[str, Array], z: Array
) -> tuple[Array, dict[str, Array]]:
    """All locations of each draw, and the log densities of all traces of each person and condition."""

    def one(draw: tuple[dict[str, Array], Array]) -> tuple[Array, dict[str, Array]]:
        sites = constrained(model, draw[0])
        solution, sums = solve(cells, population(model, sites))
        b = locations_of(cells, solution, draw[1])
        return b, _scores(model, cells, sums, codes, sites, b)

    return jax.lax.map(one, (raw, z))


def _scores(
    model: TraceModel,
    cells: Cells,
    sums: CellSums,
    codes: dict[str, Array],
    sites: dict[str, Array],
    b: Array,
) -> dict[str, Array]:
    """Log densities of all traces together, and of a person's or a condition's with its effects left out."""
    size, parts = len(cells.slope), model.locations.parts
    here = expected_by_place(cells.arrangement, b)[:size]
    start = expected_by_place(cells.arrangement, cells.reference)[:size]
    moved = [v - v0 for v, v0 in zip(here, start, strict=True)]

    def at(away: list[Array]) -> tuple[Array, list[Array]]:
        bent = [sum(sums.entry(a, c) * away[c] for c in range(size)) for a in range(size)]
        value = cells.level + sums.constant
        value = value + sum(d * (sums.pull[a] - bent[a] / 2) for a, d in enumerate(away))
        return value, [sums.pull[a] - bent[a] for a in range(size)]

    scores = {"traces": at(moved)[0].sum()}
    for group in GROUPS:
        names = [f"{group}_effect_{q}" for q in ("K", "C")]
        # Counted from the model, so that the sums have a fixed size.
        own = [b[parts[name]] if name in parts else None for name in names]
        count = max((len(each) for each in own if each is not None), default=0)
        if not count:
            continue
        away = [d if e is None else d - e[codes[group]] for d, e in zip(moved[:2], own, strict=True)]
        value, pull = at([*away, *moved[2:]])

        def total(values: Array, group: str = group, count: int = count) -> Array:
            return jax.ops.segment_sum(values, codes[group], count)

        gained = integrated_effects(
            model,
            sites,
            group,
            [total(sums.entry(0, 0)), total(sums.entry(0, 1)), total(sums.entry(1, 1))],
            [total(pull[0]), total(pull[1])],
        )
        scores[f"traces_of_{group}"] = total(value) + gained
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
