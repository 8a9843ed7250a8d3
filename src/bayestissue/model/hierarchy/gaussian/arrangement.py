"""The design of the population, arranged for blocked elimination.

b holds all fixed and group effects. Of mixed models with nested and crossed terms the group effects of one
grouping factor, with all that is nested in it, are independent between that factor's levels once the other
effects are given: their part of b's precision is block diagonal. Which effects these are is found from the
columns: those whose non-zero cells all lie in one level. See Bates et al. (2015, doi:10.18637/jss.v067.i01).

Three words recur. A *cell* is a row of X that differs from the others, with the impacts
that have it. A *level* is one of the chosen grouping factor's, to which each cell belongs. The *table* has
slots for the cells, row by row, all cells of a row being of one level: the arithmetic of a level is that of
rows of arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jaxtyping import Bool, Float, Int

from bayestissue.base.impact_arrays import IndexPerImpact, bucket
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor


class TableSettings(NamedTuple):
    """How the table is laid out; what is computed by it is the same whatever they are.

    Attributes:
        impacts_at_once: what is made of so many stays in a processor's cache.
        slots_per_cell: at the most. Rows as long as the level with the most cells give each level one row,
            which is the least work unless most slots are then empty.
    """

    impacts_at_once: int = 4096
    slots_per_cell: int = 2


SETTINGS = TableSettings()


class PopulationDesign(NamedTuple):
    """X b by cell: the rows of X that differ, in a table of levels.

    A level with many more cells than others takes several rows of the table, and a cell with many more
    impacts than others several slots. Slots that a row doesn't need are empty: their columns are zero, and
    so is all that is summed over their impacts. Cells are numbered by their slots, row by row.

    Attributes:
        cell: of each impact.
        members: the impacts of each cell, some of them at once; one past the last impact where none is.
        level: of each row of the table.
        inner: of each parameter of an impact, the columns of its level's own elements of b.
        inner_element: which elements of b these are, one past the last of b where a level has fewer.
        outer: of each parameter, the columns of all other elements of b; one row where all rows' are alike.
        outer_element: which elements these are.
        mass_error: what an error of log mass of 1, shared by impacts, adds to each of an impact's parameters.
            Columns and elements of these errors then follow those of the parameters, as if they were one
            parameter more. None of a design without them.
    """

    cell: Int[np.ndarray | Array, " impact"]
    members: Int[np.ndarray | Array, "block member cell"]
    level: Int[np.ndarray | Array, " row"]
    inner: tuple[Float[Any, "inner row slot"], ...]
    inner_element: tuple[Int[Any, "inner level"], ...]
    outer: tuple[Float[Any, "#row slot outer"], ...]
    outer_element: tuple[Int[Any, " outer"], ...]
    mass_error: Float[np.ndarray | Array, " parameter"] | None = None

    def subset(self, rows: Int[np.ndarray, " row"]) -> PopulationDesign:
        """The same population over some of the impacts."""
        cell = np.asarray(self.cell)[rows]
        return self._replace(cell=cell, members=_members(cell, self.members.shape[2]))

    def to_cells(self, values: Float[Array, "*batch impact"]) -> Float[Array, "*batch cell"]:
        """Sums over each cell's impacts."""
        none = jnp.zeros((*values.shape[:-1], 1))
        return jnp.concatenate([values, none], axis=-1)[..., self.members].sum((-3, -2))

    def of_parameters(self, values: Float[Array, "part *draw cell"]) -> Float[Array, "parameter *draw cell"]:
        """What the columns come to in each parameter, an error of the mass added to those that it moves."""
        if self.mass_error is None:
            return values
        return values[:-1] + jnp.einsum("a,...->a...", self.mass_error, values[-1])

    def of_parts(
        self, precision: Float[Array, "parameter parameter cell"], shift: Float[Array, "parameter cell"]
    ) -> tuple[Float[Array, "part part cell"], Float[Array, "part cell"]]:
        """Precision and shift of a factor of `of_parameters`, as a factor of what that is made of."""
        if (moved := self.mass_error) is None:
            return precision, shift
        across = jnp.einsum("a,ab...->b...", moved, precision)
        last = jnp.concatenate([across, jnp.einsum("a,a...->...", moved, across)[None]])
        precision = jnp.concatenate([jnp.concatenate([precision, across[:, None]], axis=1), last[None]])
        return precision, jnp.concatenate([shift, jnp.einsum("a,a...->...", moved, shift)[None]])

    def blocked(self, factors: GaussianFactor) -> GaussianFactor:
        """Impacts' factors by cell: [block, parameter, ..., member, cell].

        Where a cell has no impact the factor says nothing, and nothing is left of it in any product.
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
) -> Float[Array, "parameter *draw cell"]:
    """X b of every cell: the expectation of each of an impact's parameters there."""
    padded = jnp.concatenate([jnp.asarray(b), jnp.zeros((*b.shape[:-1], 1))], axis=-1)
    values = []
    for inner, inner_element, outer, outer_element in zip(*design[3:7], strict=True):
        value = jnp.einsum("...o,rpo->...rp", padded[..., outer_element], jnp.asarray(outer))
        inner_b = padded[..., inner_element][..., jnp.asarray(design.level), None]
        value = value + (jnp.asarray(inner) * inner_b).sum(-3)
        values.append(value.reshape(*b.shape[:-1], -1))
    return design.of_parameters(jnp.stack(values))


def arrange(
    columns: Sequence[Float[np.ndarray, "cell column"]],
    cell: IndexPerImpact,
    groups: Sequence[slice],
    mass_error: Float[np.ndarray, " parameter"] | None = None,
) -> PopulationDesign:
    """Arrange the design's columns for elimination.

    Of all grouping factors that one is chosen which leaves the least arithmetic.

    Args:
        columns: X of each parameter of an impact; their elements of b follow one another.
        cell: of every impact, the row of these columns.
        groups: the elements of b that are the effects of one group term each.
        mass_error: see `PopulationDesign`; the last of ``columns`` are then those of the errors.
    """
    # Cells of which none has many more impacts than others.
    cell = np.asarray(cell)
    (whole, _), cell = _distinct(cell, _number_within(cell) // _length(cell, len(columns[0])))
    columns = [matrix[whole] for matrix in columns]
    begins = np.cumsum([0, *(matrix.shape[1] for matrix in columns)])
    all_columns = np.concatenate(columns, axis=1)
    factor = min(_factors(all_columns, begins, groups), key=_Factor.cost)
    table = _table(factor, all_columns[:, factor.of_element < 0])
    of_parameters = []
    for matrix, begin in zip(columns, begins[:-1], strict=True):
        elements = factor.elements(begin, begin + matrix.shape[1])
        others = np.setdiff1d(np.arange(begin, begin + matrix.shape[1]), elements)
        # One more column is that of elements which a level does not have.
        padded = np.concatenate([matrix, np.zeros((len(matrix), 1))], axis=1)
        column = np.where(elements < begins[-1], elements - begin, matrix.shape[1])[:, factor.level]
        inner = padded[np.arange(len(matrix)), column]
        of_parameters.append((table.inner(inner), elements, table.outer(matrix[:, others - begin]), others))
    number = (table.row * table.slots + table.slot)[cell]
    members = _members(number, len(table.level) * table.slots)
    arranged = PopulationDesign(number, members, table.level, *zip(*of_parameters, strict=True))
    return arranged._replace(mass_error=mass_error)


@dataclass(frozen=True)
class _Factor:
    """A grouping factor: the level of every cell, and of each element of b, -1 where that has none."""

    level: Int[np.ndarray, " cell"]
    levels: int
    of_element: Int[np.ndarray, " location"]
    begins: Int[np.ndarray, " end"]

    def elements(self, begin: int, end: int) -> Int[np.ndarray, "inner level"]:
        """Each level's elements of b among some, one past the last where it has fewer than others."""
        levels = self.of_element[begin:end]
        nested = np.flatnonzero(levels >= 0)
        number = _number_within(levels[nested])
        table = np.full((number.max(initial=-1) + 1, self.levels), self.begins[-1])
        table[number, levels[nested]] = begin + nested
        return table

    def cost(self) -> float:
        """Multiplications of a blocked Cholesky factor."""
        r = sum(len(self.elements(*pair)) for pair in pairwise(self.begins))
        q = int((self.of_element < 0).sum())
        return self.levels * (r**3 / 3 + r * r * q + r * q * q) + q**3 / 3


def _factors(
    whole: Float[np.ndarray, "cell location"], begins: Int[np.ndarray, " end"], groups: Sequence[slice]
) -> Iterator[_Factor]:
    """What could be eliminated level by level: nothing, or what is nested in one of the group terms."""
    nothing = np.full(begins[-1], -1)
    yield _Factor(np.zeros(len(whole), int), 1, nothing, begins)
    present = [whole[:, group] != 0 for group in groups]
    for factor in present:
        if (factor.sum(1) == 1).all():
            level, levels, of_element = factor.argmax(1), factor.shape[1], nothing.copy()
            for group, nonzero in zip(groups, present, strict=True):
                of_element[group] = _levels_of_effects(nonzero, level, levels)
            yield _Factor(level, levels, of_element, begins)


def _levels_of_effects(
    nonzero: Bool[np.ndarray, "cell effect"], level: Int[np.ndarray, " cell"], levels: int
) -> Int[np.ndarray, " effect"]:
    """The level in which all cells of an effect lie, -1 where they lie in several."""
    cells, effects = np.nonzero(nonzero)
    least, greatest = np.full(nonzero.shape[1], levels), np.full(nonzero.shape[1], -1)
    np.minimum.at(least, effects, level[cells])
    np.maximum.at(greatest, effects, level[cells])
    nested = np.where(least == greatest, least, -1)
    # Effects without any cell go where they cost nothing: to the factor's levels, if they match them.
    matches = len(least) == levels and (nested >= 0).any()
    return np.where(greatest < 0, np.arange(levels) if matches else -1, nested)


@dataclass(frozen=True)
class _Table:
    """Where each cell stands.

    Attributes:
        level: of each row.
        slots: of a row.
        row: of each cell.
        slot: of each cell, in its row.
        shared: whether the outer columns of a slot are the same in all rows.
    """

    level: Int[np.ndarray, " row"]
    slots: int
    row: Int[np.ndarray, " cell"]
    slot: Int[np.ndarray, " cell"]
    shared: bool

    def inner(self, values: Float[np.ndarray, "inner cell"]) -> Float[np.ndarray, "inner row slot"]:
        """Values of cells in the table, zero in its empty slots."""
        table = np.zeros((len(values), len(self.level), self.slots))
        table[:, self.row, self.slot] = values
        return table

    def outer(self, values: Float[np.ndarray, "cell outer"]) -> Float[np.ndarray, "#row slot outer"]:
        """The same of outer columns, one row where all are alike."""
        rows, row = (1, 0) if self.shared else (len(self.level), self.row)
        table = np.zeros((rows, self.slots, values.shape[1]))
        table[row, self.slot] = values
        return table


def _table(factor: _Factor, outer: Float[np.ndarray, "cell outer"]) -> _Table:
    """Cells in rows of one level each.

    Where all people meet the same conditions, a slot is a condition: one person's outer columns are
    everyone's.
    """
    conditions, slot = np.unique(outer, axis=0, return_inverse=True)
    slot = slot.reshape(-1)
    once = len(_distinct(factor.level, slot)[0][0]) == len(slot)
    shared = once and factor.levels * len(conditions) <= SETTINGS.slots_per_cell * len(slot)
    if shared:
        slots, row_of_level = len(conditions), np.zeros_like(slot)
    else:
        slots = _length(factor.level, factor.levels)
        row_of_level, slot = np.divmod(_number_within(factor.level), slots)
    # A row of each level, also of one without cells.
    levels = np.arange(factor.levels)
    keys = np.append(factor.level, levels), np.append(row_of_level, np.zeros_like(levels))
    (level, _), row = _distinct(*keys)
    return _Table(level, bucket(slots), row[: len(slot)], slot, shared)


def _number_within(codes: Int[np.ndarray, " item"]) -> Int[np.ndarray, " item"]:
    """Of each item its number among those of the same code."""
    return pd.Series(codes).groupby(codes).cumcount().to_numpy()


def _length(codes: Int[np.ndarray, " item"], count: int) -> int:
    """Of a table of ``count`` codes: as many items as any code has, fewer if most slots were then empty."""
    most = int(np.bincount(codes).max(initial=1))
    return most if most * count <= SETTINGS.slots_per_cell * len(codes) else max(1, len(codes) // count)


def _distinct(*keys: Int[np.ndarray, " item"]) -> tuple[Int[np.ndarray, "key one"], Int[np.ndarray, " item"]]:
    """The different items, in order, and which of these each item is."""
    items, which = np.unique(np.stack(keys), axis=1, return_inverse=True)
    return items, which.reshape(-1)


def _members(cell: IndexPerImpact, cells: int) -> Int[np.ndarray, "block member cell"]:
    number = _number_within(cell)
    most = bucket(int(number.max(initial=0)) + 1)
    blocks = -(-most * cells // max(SETTINGS.impacts_at_once, cells))
    of_block = -(-most // blocks)
    members = np.full((blocks * of_block, cells), len(cell))
    members[number, cell] = np.arange(len(cell))
    return members.reshape(blocks, of_block, cells)
