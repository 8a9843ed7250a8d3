"""The hierarchy's closed forms for many impacts: sums over cells first, then the people, then the rest.

`bayestissue.hierarchy.gaussian.conditional` factors one dense matrix over all locations, whose cost grows
with the cube of the number of people. Given everything else people are independent of each other, so that
here their effects are eliminated one by one, two by two entries each, and only what is left needs a dense
factor: the same numbers up to rounding. Impacts of one cell share a row of the design, so that each impact is
visited only to sum its part of the cell's.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.gaussian.conditional import Sites
from bayestissue.hierarchy.population import Effects, PopulationDesign

# As many places as this times the cells are laid out, if that lets all people share their columns.
_MOST_EMPTY = 2


class Arrangement(NamedTuple):
    """Where everything lies. A place is a person's slot for a cell, and stays empty where there is none.

    Where all people meet the same conditions, a slot is a condition, and one person's columns are everyone's.

    Attributes:
        members: impacts of each place; one past the last where there are fewer.
        place: of each impact.
        inner: elements of b that are a person's effects, eliminated first; a row each of log K and log C.
        rest: the other elements of b.
        columns: per parameter of an impact, the rest's columns of the design, of each person or of all.
    """

    members: Int[np.ndarray, "repeat place"]
    place: Int[np.ndarray, " impact"]
    inner: dict[int, Int[np.ndarray, " level"]]
    rest: Int[np.ndarray, " rest"]
    columns: tuple[Float[np.ndarray, "#level slot part"], ...]


def arrange(locations: Effects, design: PopulationDesign, group: str | None = None) -> Arrangement:
    """Lay the impacts out by person and cell.

    Args:
        locations: what the elements of b are.
        design: X over cells.
        group: "subject" or "trial", whose effects are eliminated first; the one of most levels unless given.
    """
    columns = [np.asarray(matrix) for matrix in design.columns]
    begin = np.cumsum([0, *(matrix.shape[1] for matrix in columns)])
    parts = {
        (each, a): locations.parts[f"{each}_effect_{q}"]
        for each in GROUPS
        for a, q in enumerate(RESPONSES)
        if f"{each}_effect_{q}" in locations.parts
    }
    sizes = {each: part.stop - part.start for (each, _), part in parts.items()}
    chosen = max(sizes, key=lambda each: sizes[each], default="") if group is None else group
    inner = {a: np.arange(part.start, part.stop) for (each, a), part in parts.items() if each == chosen}
    cells = len(columns[0])
    level = np.zeros(cells, int)
    for a, elements in inner.items():
        level = columns[a][:, elements - begin[a]].argmax(axis=1)
    levels = sizes.get(chosen, 1)
    taken = np.concatenate([np.empty(0, int), *inner.values()])
    kept = [np.setdiff1d(np.arange(begin[a], begin[a + 1]), taken) for a in range(len(columns))]
    rest = [matrix[:, kept[a] - begin[a]] for a, matrix in enumerate(columns)]
    slot, laid = _slots(rest, level, levels)
    slots = laid[0].shape[1]
    place = (level * slots + slot)[np.asarray(design.cell)]
    order, repeats = _positions(place, levels * slots)
    members = np.full((repeats, levels * slots), len(place))
    members[order, place] = np.arange(len(place))
    return Arrangement(members, place, inner, np.concatenate(kept), laid)


def _slots(
    rest: list[np.ndarray], level: np.ndarray, levels: int
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Each cell's slot, and the columns by level and slot: one level for all where all have the same rows."""
    _, first, row = np.unique(np.concatenate(rest, axis=1), axis=0, return_index=True, return_inverse=True)
    if levels * len(first) <= _MOST_EMPTY * len(level):
        return row.reshape(-1), tuple(matrix[first][None] for matrix in rest)
    slot, slots = _positions(level, levels)
    laid = [np.zeros((levels, slots, matrix.shape[1])) for matrix in rest]
    for whole, matrix in zip(laid, rest, strict=True):
        whole[level, slot] = matrix
    return slot, tuple(laid)


def _positions(codes: np.ndarray, count: int) -> tuple[np.ndarray, int]:
    """The how-manieth of its code each element is, and the greatest number of elements of one code."""
    order = np.argsort(codes, kind="stable")
    number = np.bincount(codes, minlength=count)
    begin = np.repeat(np.cumsum(number) - number, number)
    position = np.empty_like(order)
    position[order] = np.arange(len(codes)) - begin
    return position, int(number.max())


class Expansion(NamedTuple):
    """What the summaries leave out of the log evidence, to second order in what the population says.

    v holds what the population expects of an impact's parameters, then the covariance of log K and log C
    about that (KK, KC, CC), then the other variances.

    Attributes:
        spreads: the part of v that is every impact's, about which it was made; the rest is the reference's.
        slope: first derivatives, summed over a place's impacts.
        bend: second derivatives.
    """

    spreads: Float[Array, " spread"]
    slope: Float[Array, "place v"]
    bend: Float[Array, "place v v"]


class Cells(NamedTuple):
    """Sites by place, expanded about X b at a reference b.

    Attributes:
        arrangement: where everything lies.
        precision: of the summaries, the lower triangle's entries.
        slope: of the log summaries, where an impact's parameters are those that the reference expects.
        level: sum over a place's impacts of the log summaries there.
        reference: b that everything is measured from.
        mean: prior mean of b.
        expansion: of what the summaries leave out, once that is known.
    """

    arrangement: Arrangement
    precision: tuple[Float[Array, "repeat place"], ...]
    slope: tuple[Float[Array, "repeat place"], ...]
    level: Float[Array, " place"]
    reference: Float[Array, " location"]
    mean: Float[Array, " location"]
    expansion: Expansion | None = None


def in_cells(
    arrangement: Arrangement,
    summaries: Sites,
    mean: Float[np.ndarray, " location"],
    reference: Float[np.ndarray, " location"],
) -> Cells:
    """Expand the summaries about what the reference expects, and lay them out.

    A last parameter of which no summary says anything, as one that has a profile, may be left out of
    ``summaries``.

    Args:
        arrangement: see `arrange`.
        summaries: of the traces.
        mean: prior mean of b.
        reference: a b near the posterior, which keeps the sums of squares small.
    """
    size = summaries.centre.shape[1]
    about = [
        np.asarray(each)[arrangement.place]
        for each in expected_by_place(arrangement, jnp.asarray(reference))[:size]
    ]
    away = np.stack(about, axis=1) - np.asarray(summaries.centre)
    precision = np.asarray(summaries.precision)
    bent = np.einsum("iab,ib->ia", precision, away)
    slope = np.asarray(summaries.slope) - bent
    level = np.asarray(summaries.log_likelihood) + (away * (np.asarray(summaries.slope) - bent / 2)).sum(1)

    def laid(values: np.ndarray) -> Array:
        return jnp.asarray(np.append(values, 0.0)[arrangement.members])

    lower = [(a, b) for a in range(size) for b in range(a + 1)]
    return Cells(
        arrangement,
        tuple(laid(precision[:, a, b]) for a, b in lower),
        tuple(laid(slope[:, a]) for a in range(size)),
        laid(level).sum(0),
        jnp.asarray(reference),
        jnp.asarray(mean),
    )


def expected_by_place(
    arrangement: Arrangement, b: Float[Array, "*draw location"]
) -> list[Float[Array, "*draw place"]]:
    """X b for each parameter of an impact, place by place."""
    values, begin = [], 0
    for a, matrix in enumerate(arrangement.columns):
        end = begin + matrix.shape[2]
        part = b[..., arrangement.rest[begin:end]]
        value = jnp.einsum("...p,lsp->...ls", part, jnp.asarray(matrix))
        if a in arrangement.inner:
            value = value + b[..., arrangement.inner[a]][..., None]
        levels = arrangement.members.shape[1] // matrix.shape[1]
        value = jnp.broadcast_to(value, (*b.shape[:-1], levels, matrix.shape[1]))
        values.append(value.reshape(*b.shape[:-1], -1))
        begin = end
    return values
