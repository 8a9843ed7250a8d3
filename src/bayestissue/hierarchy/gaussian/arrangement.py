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

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

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
        cell: of each impact, its place in the table.
        members: the impacts of each place, some repeats at once; one past the last impact where none is.
        level: of each row of the table.
        inner: of each parameter of an impact, the values of the columns of its own effects at every place.
        inner_element: which elements of b these are, one past the last of b where a level has fewer.
        rest: of each parameter, the columns of all other elements of b; of one row where all rows' are alike.
        rest_element: which elements these are.
    """

    cell: Int[np.ndarray | Array, " impact"]
    members: Int[np.ndarray | Array, "block repeat place"]
    level: Int[np.ndarray | Array, " row"]
    inner: tuple[Float[Any, "own row slot"], ...]
    inner_element: tuple[Int[Any, "own group"], ...]
    rest: tuple[Float[Any, "#row slot part"], ...]
    rest_element: tuple[Int[Any, " part"], ...]

    def some(self, rows: Int[np.ndarray, " row"]) -> PopulationDesign:
        """The same population over some of the impacts."""
        cell = np.asarray(self.cell)[rows]
        return self._replace(cell=cell, members=_members(cell, self.members.shape[2]))

    def to_cells(self, values: Float[Array, "*batch impact"]) -> Float[Array, "*batch place"]:
        """Sums over each place's impacts."""
        none = jnp.zeros((*values.shape[:-1], 1))
        return jnp.concatenate([values, none], axis=-1)[..., self.members].sum((-3, -2))


def expected(
    design: PopulationDesign, b: Float[Array, "*draw location"]
) -> Float[Array, "parameter *draw impact"]:
    """X b of every impact."""
    return expected_by_cell(design, b)[..., design.cell]


def expected_by_cell(
    design: PopulationDesign, b: Float[Array, "*draw location"]
) -> Float[Array, "parameter *draw place"]:
    """X b of every place: the expectation of each of an impact's parameters there."""
    padded = jnp.concatenate([jnp.asarray(b), jnp.zeros((*b.shape[:-1], 1))], axis=-1)
    values = []
    for inner, element, rest, others in zip(*design[3:], strict=True):
        value = jnp.einsum("...p,rsp->...rs", padded[..., others], jnp.asarray(rest))
        own = padded[..., element][..., jnp.asarray(design.level), None]
        value = value + (jnp.asarray(inner) * own).sum(-3)
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
    # A cell of many more impacts than others takes several places, each with the cell's row of the design.
    part, _, _ = _positions(np.asarray(cell), len(columns[0]))
    (of_place, _), place = _distinct(np.asarray(cell), part)
    part, slot, slots = _positions(nesting.level[of_place], nesting.levels)
    alike = _slots_alike(nesting, columns, of_place)
    if alike is not None:
        part, slot, slots = np.zeros_like(alike), alike, int(alike.max()) + 1
    slots = bucket(slots)
    every = np.arange(nesting.levels)
    (level, _), row = _distinct(
        np.append(nesting.level[of_place], every), np.append(part, np.zeros_like(every))
    )
    at, places = row[: len(slot)] * slots + slot, len(level) * slots
    inner, inner_element, rest, rest_element = [], [], [], []
    for matrix, begin in zip(columns, begins[:-1], strict=True):
        element = nesting.elements(begin, begin + matrix.shape[1])
        padded = np.concatenate([matrix, np.zeros((len(matrix), 1))], axis=1)
        column = np.where(element < begins[-1], element - begin, matrix.shape[1])
        values = np.zeros((len(element), places))
        values[:, at] = padded[of_place, column[:, nesting.level[of_place]]]
        others = np.setdiff1d(np.arange(begin, begin + matrix.shape[1]), element)
        laid = np.zeros((places if alike is None else slots, len(others)))
        laid[at if alike is None else slot] = matrix[of_place][:, others - begin]
        inner.append(values.reshape(len(element), len(level), slots))
        inner_element.append(element)
        rest.append(laid.reshape(-1, slots, len(others)))
        rest_element.append(others)
    arranged = tuple(map(tuple, (inner, inner_element, rest, rest_element)))
    return PopulationDesign(at[place], _members(at[place], places), level, *arranged)


def _slots_alike(
    nesting: _Nesting, columns: Sequence[np.ndarray], of_place: np.ndarray
) -> Int[np.ndarray, " place"] | None:
    """Of each place a slot whose columns of the rest are the same in all rows, if that is possible.

    Where all people meet the same conditions, a slot is a condition, and one person's columns are everyone's.
    """
    whole = np.concatenate(columns, axis=1)[:, nesting.of_element < 0]
    found, code = np.unique(whole, axis=0, return_inverse=True)
    slot, level = code.reshape(-1)[of_place], nesting.level[of_place]
    several = len(_distinct(level, slot)[0][0]) < len(slot)
    return None if several or nesting.levels * len(found) > _MOST_EMPTY * len(slot) else slot


@dataclass(frozen=True)
class _Nesting:
    """A grouping factor's level of every cell, and of each element of b, or -1 where that has none."""

    level: Int[np.ndarray, " cell"]
    levels: int
    of_element: Int[np.ndarray, " location"]
    begins: Int[np.ndarray, " end"]

    def elements(self, begin: int, end: int) -> Int[np.ndarray, "own level"]:
        """Each level's elements of b among some, one past the last where it has fewer than others."""
        of = self.of_element[begin:end]
        own = np.flatnonzero(of >= 0)
        number = np.bincount(of[own], minlength=self.levels)
        table = np.full((number.max(), self.levels), self.begins[-1])
        _, position, _ = _positions(of[own], self.levels, most_empty=np.inf)
        table[position, of[own]] = begin + own
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
        for group, own in zip(groups, present, strict=True):
            cells, effects = np.nonzero(own)
            least, greatest = np.full(own.shape[1], levels), np.full(own.shape[1], -1)
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
    """Items of the same code in parts of one length: of each its part, its place there, and the length."""
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
    found, which = np.unique(np.stack(keys), axis=1, return_inverse=True)
    return found, which.reshape(-1)


def _members(place: Int[np.ndarray, " impact"], places: int) -> Int[np.ndarray, "block repeat place"]:
    _, position, repeats = _positions(place, places, most_empty=np.inf)
    repeats = bucket(repeats)
    blocks = -(-repeats * places // max(AT_ONCE, places))
    each = -(-repeats // blocks)
    members = np.full((blocks * each, places), len(place))
    members[position, place] = np.arange(len(place))
    return members.reshape(blocks, each, places)
