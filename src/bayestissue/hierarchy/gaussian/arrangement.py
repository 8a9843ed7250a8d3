"""The design of the population, arranged for blocked elimination.

b holds all fixed and group effects. Of mixed models with nested and crossed terms the group effects of one
grouping factor, with all that is nested in it, are independent between that factor's levels once the other
effects are given: their part of b's precision is block diagonal. Which effects these are is found from the
columns: those whose non-zero cells all lie in one level. See Bates et al. (2015, doi:10.18637/jss.v067.i01).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.padding import bucket

# So many impacts are worked on at once: what is made of them stays in a processor's cache.
AT_ONCE = 4096
# Places as many times as those that are needed, if that makes all levels equally long.
_MOST_EMPTY = 2


class PopulationDesign(NamedTuple):
    """X b by cell: rows of the design that differ, in a table of levels of the chosen factor and slots.

    A level with many more cells than others takes several rows of the table. Slots that a row doesn't need
    are empty: their columns are zero, and so is all that is summed over their impacts.

    Attributes:
        cell: of each impact, its entry of the table.
        members: the impacts of each entry, some repeats at once; one past the last impact where none is.
        level: of each row of the table.
        inner: of each parameter of an impact, the columns of its level's effects at every entry.
        inner_element: which elements of b these are, one past the last of b where a level has fewer.
        outer: of each parameter, the columns of all other elements of b, one row where all rows' are alike.
        outer_element: which elements these are.
    """

    cell: Int[np.ndarray | Array, " impact"]
    members: Int[np.ndarray | Array, "block repeat entry"]
    level: Int[np.ndarray | Array, " row"]
    inner: tuple[Float[Any, "inner row slot"], ...]
    inner_element: tuple[Int[Any, "inner group"], ...]
    outer: tuple[Float[Any, "#row slot part"], ...]
    outer_element: tuple[Int[Any, " part"], ...]

    def subset(self, rows: Int[np.ndarray, " row"]) -> PopulationDesign:
        """The same population over some of the impacts."""
        cell = np.asarray(self.cell)[rows]
        return self._replace(cell=cell, members=_members(cell, self.members.shape[2]))

    def to_cells(self, values: Float[Array, "*batch impact"]) -> Float[Array, "*batch entry"]:
        """Sums over each entry's impacts."""
        none = jnp.zeros((*values.shape[:-1], 1))
        return jnp.concatenate([values, none], axis=-1)[..., self.members].sum((-3, -2))

    def blocked(self, factors: GaussianFactor) -> GaussianFactor:
        """Impacts' factors by entry: [block, parameter, ..., repeat, entry].

        Entries without an impact have factors that say nothing, of which nothing is left in any product.
        """

        def arranged(values: Any) -> Any:
            xp = values.__array_namespace__()
            padded = xp.concat([values, xp.zeros((1, *values.shape[1:]))])
            return xp.moveaxis(padded[self.members], (1, 2), (-2, -1))

        return jax.tree.map(arranged, factors)


def expected(
    design: PopulationDesign, b: Float[Array, "*draw location"]
) -> Float[Array, "parameter *draw impact"]:
    """X b of every impact."""
    return expected_by_cell(design, b)[..., design.cell]


@jax.jit
def expected_by_cell(
    design: PopulationDesign, b: Float[Array, "*draw location"]
) -> Float[Array, "parameter *draw entry"]:
    """X b of every entry: the expectation of each of an impact's parameters there."""
    padded = jnp.concatenate([jnp.asarray(b), jnp.zeros((*b.shape[:-1], 1))], axis=-1)
    values = []
    for inner, element, outer, others in zip(*design[3:], strict=True):
        value = jnp.einsum("...p,rsp->...rs", padded[..., others], jnp.asarray(outer))
        inner_b = padded[..., element][..., jnp.asarray(design.level), None]
        value = value + (jnp.asarray(inner) * inner_b).sum(-3)
        values.append(value.reshape(*b.shape[:-1], -1))
    return jnp.stack(values)


def arrange(
    columns: Sequence[Float[np.ndarray, "cell part"]],
    cell: Int[np.ndarray, " impact"],
    groups: Sequence[slice],
) -> PopulationDesign:
    """Arrange the design's columns for elimination.

    Of all grouping factors that one is chosen which leaves the least arithmetic.

    Args:
        columns: of each parameter of an impact; their elements of b follow one another.
        cell: of every impact, the row of these columns.
        groups: the elements of b that are the effects of one group term each.
    """
    begins = np.cumsum([0, *(matrix.shape[1] for matrix in columns)])
    nesting = min(_nestings(columns, begins, groups), key=_Nesting.cost)
    # A cell of many more impacts than others takes several entries, each with the cell's row of the design.
    part, _, _ = _positions(np.asarray(cell), len(columns[0]))
    (cell_of_entry, _), entry = _distinct(np.asarray(cell), part)
    part, slot, slots = _positions(nesting.level[cell_of_entry], nesting.levels)
    shared_slot = _shared_slots(nesting, columns, cell_of_entry)
    if shared_slot is not None:
        part, slot, slots = np.zeros_like(shared_slot), shared_slot, int(shared_slot.max()) + 1
    slots = bucket(slots)
    all_levels = np.arange(nesting.levels)
    (level, _), row = _distinct(
        np.append(nesting.level[cell_of_entry], all_levels), np.append(part, np.zeros_like(all_levels))
    )
    at, entries = row[: len(slot)] * slots + slot, len(level) * slots
    inner, inner_element, outer, outer_element = [], [], [], []
    for matrix, begin in zip(columns, begins[:-1], strict=True):
        element = nesting.elements(begin, begin + matrix.shape[1])
        padded = np.concatenate([matrix, np.zeros((len(matrix), 1))], axis=1)
        column = np.where(element < begins[-1], element - begin, matrix.shape[1])
        values = np.zeros((len(element), entries))
        values[:, at] = padded[cell_of_entry, column[:, nesting.level[cell_of_entry]]]
        others = np.setdiff1d(np.arange(begin, begin + matrix.shape[1]), element)
        outer_columns = np.zeros((entries if shared_slot is None else slots, len(others)))
        outer_columns[at if shared_slot is None else slot] = matrix[cell_of_entry][:, others - begin]
        inner.append(values.reshape(len(element), len(level), slots))
        inner_element.append(element)
        outer.append(outer_columns.reshape(-1, slots, len(others)))
        outer_element.append(others)
    arranged = tuple(map(tuple, (inner, inner_element, outer, outer_element)))
    return PopulationDesign(at[entry], _members(at[entry], entries), level, *arranged)


def _shared_slots(
    nesting: _Nesting, columns: Sequence[np.ndarray], cell_of_entry: np.ndarray
) -> Int[np.ndarray, " entry"] | None:
    """Of each entry a slot whose outer columns are the same in all rows, if that is possible.

    Where all people meet the same conditions, a slot is a condition, and one person's columns are everyone's.
    """
    whole = np.concatenate(columns, axis=1)[:, nesting.of_element < 0]
    distinct, code = np.unique(whole, axis=0, return_inverse=True)
    slot, level = code.reshape(-1)[cell_of_entry], nesting.level[cell_of_entry]
    several = len(_distinct(level, slot)[0][0]) < len(slot)
    return None if several or nesting.levels * len(distinct) > _MOST_EMPTY * len(slot) else slot


@dataclass(frozen=True)
class _Nesting:
    """A grouping factor's level of every cell, and of each element of b, or -1 where that has none."""

    level: Int[np.ndarray, " cell"]
    levels: int
    of_element: Int[np.ndarray, " location"]
    begins: Int[np.ndarray, " end"]

    def elements(self, begin: int, end: int) -> Int[np.ndarray, "inner level"]:
        """Each level's elements of b among some, one past the last where it has fewer than others."""
        levels = self.of_element[begin:end]
        nested = np.flatnonzero(levels >= 0)
        number = np.bincount(levels[nested], minlength=self.levels)
        table = np.full((number.max(), self.levels), self.begins[-1])
        _, position, _ = _positions(levels[nested], self.levels, most_empty=np.inf)
        table[position, levels[nested]] = begin + nested
        return table

    def cost(self) -> float:
        """Multiplications of a blocked Cholesky factor."""
        r = sum(len(self.elements(*pair)) for pair in pairwise(self.begins))
        q = int((self.of_element < 0).sum())
        return self.levels * (r**3 / 3 + r * r * q + r * q * q) + q**3 / 3


def _nestings(
    columns: Sequence[np.ndarray], begins: np.ndarray, groups: Sequence[slice]
) -> Iterator[_Nesting]:
    """What could be eliminated level by level: nothing, or what is nested in one of the group terms."""
    nothing = np.full(begins[-1], -1)
    yield _Nesting(np.zeros(len(columns[0]), int), 1, nothing, begins)
    owners = [int(np.searchsorted(begins, group.start, side="right")) - 1 for group in groups]
    present = [
        columns[a][:, group.start - begins[a] : group.stop - begins[a]] != 0
        for a, group in zip(owners, groups, strict=True)
    ]
    for factor in present:
        if not (factor.sum(1) == 1).all():
            continue
        level, levels = factor.argmax(1), factor.shape[1]
        of_element = nothing.copy()
        for group, nonzero in zip(groups, present, strict=True):
            cells, effects = np.nonzero(nonzero)
            least, greatest = np.full(nonzero.shape[1], levels), np.full(nonzero.shape[1], -1)
            np.minimum.at(least, effects, level[cells])
            np.maximum.at(greatest, effects, level[cells])
            nested = np.where(least == greatest, least, -1)
            # Effects without any cell go where they cost nothing: to the factor's levels, if they match them.
            matches = len(least) == levels and (nested >= 0).any()
            unused = np.arange(levels) if matches else -1
            of_element[group] = np.where(greatest < 0, unused, nested)
        yield _Nesting(level, levels, of_element, begins)


def _positions(
    codes: Int[np.ndarray, " item"], count: int, *, most_empty: float = _MOST_EMPTY
) -> tuple[Int[np.ndarray, " item"], Int[np.ndarray, " item"], int]:
    """Items of the same code in parts of one length: of each its part, its position there, and the length."""
    order = np.argsort(codes, kind="stable")
    number = np.bincount(codes, minlength=count)
    position = np.empty_like(order)
    position[order] = np.arange(len(codes)) - np.repeat(np.cumsum(number) - number, number)
    length = int(number.max(initial=1))
    if length * count > most_empty * len(codes):
        length = max(1, len(codes) // count)
    return position // length, position % length, length


def _distinct(*keys: Int[np.ndarray, " item"]) -> tuple[Int[np.ndarray, "key one"], Int[np.ndarray, " item"]]:
    """The different items, in order, and which of these each item is."""
    items, which = np.unique(np.stack(keys), axis=1, return_inverse=True)
    return items, which.reshape(-1)


def _members(entry: Int[np.ndarray, " impact"], entries: int) -> Int[np.ndarray, "block repeat entry"]:
    _, position, repeats = _positions(entry, entries, most_empty=np.inf)
    repeats = bucket(repeats)
    blocks = -(-repeats * entries // max(AT_ONCE, entries))
    per_block = -(-repeats // blocks)
    members = np.full((blocks * per_block, entries), len(entry))
    members[position, entry] = np.arange(len(entry))
    return members.reshape(blocks, per_block, entries)
