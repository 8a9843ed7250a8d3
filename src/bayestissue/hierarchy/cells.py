"""The hierarchy's closed forms for many impacts: sums over cells first, then the people, then the rest.

`bayestissue.hierarchy.conditional` factors one dense matrix over all locations, whose cost grows with the
cube of the number of people. Given everything else people are independent of each other, so that here their
effects are eliminated one by one, two by two entries each, and only what is left needs a dense factor: the
same numbers up to rounding. Impacts of one cell share a row of the design, so that each impact is visited
only to sum its part of the cell's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float, Int

from bayestissue.hierarchy.conditional import Summaries
from bayestissue.hierarchy.design import GROUPS
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.population import Locations, PopulationDesign, Spread
from bayestissue.likelihood import small

Entries = tuple[Array, ...]
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


def arrange(locations: Locations, design: PopulationDesign, group: str | None = None) -> Arrangement:
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
    """Summaries by place, expanded about X b at a reference b.

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
    summaries: Summaries,
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
    about = [np.asarray(each)[arrangement.place] for each in expected_by_place(arrangement, reference)[:size]]
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


class CellSums(NamedTuple):
    """Each place's sums over its impacts, all at the reference.

    Attributes:
        weight: W, the lower triangle's entries: minus the second derivatives of the log evidence by X b.
        pull: its first derivatives.
        constant: the log evidence less the level of `Cells`.
    """

    weight: tuple[Float[Array, " place"], ...]
    pull: tuple[Float[Array, " place"], ...]
    constant: Float[Array, " place"]

    def entry(self, a: int, b: int) -> Array:
        """An entry of W."""
        return self.weight[_lower(a, b)]


def cell_sums(cells: Cells, spread: Spread) -> CellSums:
    """Integrate every impact's parameters out, and sum within places."""
    nuisance = spread.nuisance[: len(cells.slope) - 2]
    sums = _summed((*spread.own, *nuisance), cells.precision, cells.slope)
    number = len(cells.precision)
    found = CellSums(tuple(sums[:number]), tuple(sums[number:-1]), sums[-1])
    return found if cells.expansion is None else _corrected(found, cells.expansion, spread)


def flat_spreads(spread: Spread, size: int) -> Float[Array, "*batch spread"]:
    """The spreads as `Expansion` has them, for impacts of ``size`` parameters."""
    return jnp.stack([*spread.own, *(sd**2 for sd in spread.nuisance[: size - 2])], axis=-1)


def _corrected(sums: CellSums, expansion: Expansion, spread: Spread) -> CellSums:
    size = len(sums.pull)
    away = flat_spreads(spread, size) - expansion.spreads
    bent = expansion.bend[:, :, size:] @ away
    weight = tuple(sums.entry(a, b) - expansion.bend[:, a, b] for a in range(size) for b in range(a + 1))
    pull = tuple(sums.pull[a] + expansion.slope[:, a] + bent[:, a] for a in range(size))
    return CellSums(weight, pull, sums.constant + (expansion.slope[:, size:] + bent[:, size:] / 2) @ away)


def _lower(a: int, b: int) -> int:
    return max(a, b) * (max(a, b) + 1) // 2 + min(a, b)


@jax.custom_vjp
def _summed(spreads: Entries, precision: Entries, slope: Entries) -> Entries:
    """W, pull and constant of every impact, summed over the first axis, a repeat at a time.

    One repeat of all places stays in a processor's cache, where all impacts at once would not.
    """

    def add(total: Entries, part: tuple[Entries, Entries]) -> tuple[Entries, None]:
        weight, pull, constant = _of_impacts(spreads, *part)
        return tuple(t + v for t, v in zip(total, (*weight, *pull, constant), strict=True)), None

    count = len(precision) + len(slope) + 1
    return jax.lax.scan(add, (jnp.zeros_like(slope[0][0]),) * count, (precision, slope))[0]


def _of_impacts(
    spreads: Entries, precision: Entries, slope: Entries
) -> tuple[list[Array], list[Array], Array]:
    """W = D - D V D with V = (P + D)^-1, D V g, and the log evidence, D being the spreads' precision."""
    size = len(slope)
    kk, kc, cc = spreads[:3]
    determinant = kk * cc - kc**2
    prior = {(0, 0): cc / determinant, (1, 0): -kc / determinant, (1, 1): kk / determinant}
    log_prior = -jnp.log(determinant) / 2
    for a, sd in enumerate(spreads[3:], start=2):
        prior[a, a] = sd**-2.0
        log_prior = log_prior - jnp.log(sd)
    factor = small.cholesky(
        [[precision[_lower(a, b)] + prior.get((a, b), 0.0) for b in range(a + 1)] for a in range(size)]
    )
    inverse = _inverse(factor)
    # Rows of L^-1 D, whose squares make D V D; a person's log K and log C are all that D ties.
    rows = [[_dot_prior(row, prior, a) for a in range(size)] for row in inverse]
    weight = [
        prior.get((a, b), 0.0) - sum(rows[k][a] * rows[k][b] for k in _reach(a, size))
        for a in range(size)
        for b in range(a + 1)
    ]
    half = [sum(inverse[k][j] * slope[j] for j in range(k + 1)) for k in range(size)]
    pull = [sum(rows[k][a] * half[k] for k in _reach(a, size)) for a in range(size)]
    return weight, pull, log_prior - small.log_diagonal(factor) + sum(h**2 for h in half) / 2


def _reach(a: int, size: int) -> range:
    """The rows of L^-1 D that are not 0 in column ``a``."""
    return range(0 if a < 2 else a, size)


def _dot_prior(row: list[Array], prior: dict[tuple[int, int], Array], a: int) -> Array:
    tied = [b for b in range(len(row)) if (max(a, b), min(a, b)) in prior]
    return sum((row[b] * prior[max(a, b), min(a, b)] for b in tied), jnp.zeros(()))


def _inverse(factor: list[list[Array]]) -> list[list[Array]]:
    """Rows of L^-1, lower triangle only."""
    inverse: list[list[Array]] = []
    for i, row in enumerate(factor):
        over = 1 / row[i]
        own = [-over * sum(row[k] * inverse[k][j] for k in range(j, i)) for j in range(i)]
        inverse.append([*own, over])
    return inverse


def _summed_forward(spreads: Entries, precision: Entries, slope: Entries) -> tuple[Entries, Any]:
    return _summed(spreads, precision, slope), (spreads, precision, slope)


def _summed_backward(given: Any, toward: Entries) -> tuple[Entries, None, None]:
    """By the spreads alone: dW = -W dS W, d pull = -W dS pull, d constant = (pull' dS pull - tr W dS) / 2."""
    spreads, precision, slope = given
    size, number = len(slope), len(precision)
    by_weight, by_pull, by_constant = toward[:number], toward[number:-1], toward[-1]
    whole = [[by_weight[_lower(a, b)] * (1.0 if a == b else 0.5) for b in range(size)] for a in range(size)]

    def add(total: Entries, part: tuple[Entries, Entries]) -> tuple[Entries, None]:
        weight, pull, _ = _of_impacts(spreads, *part)
        rows = [[weight[_lower(a, b)] for b in range(size)] for a in range(size)]
        over = [small.times(whole, row) for row in rows]
        moved = small.times(rows, by_pull)

        def entry(a: int, b: int) -> Array:
            bent = -small.dot(rows[a], over[b]) - (pull[a] * moved[b] + pull[b] * moved[a]) / 2
            return (bent + by_constant * (pull[a] * pull[b] - rows[a][b]) / 2).sum()

        kk, kc, cc = entry(0, 0), entry(0, 1), entry(1, 1)
        slopes = (kk, 2 * kc, cc, *(2 * sd * entry(a, a) for a, sd in enumerate(spreads[3:], start=2)))
        return tuple(t + s for t, s in zip(total, slopes, strict=True)), None

    found, _ = jax.lax.scan(add, (jnp.zeros(()),) * len(spreads), (precision, slope))
    return found, None, None


_summed.defvjp(_summed_forward, _summed_backward)


class Solution(NamedTuple):
    """b given the standard deviations, measured from the reference.

    Attributes:
        log_evidence: log density of all summaries, b and every impact's parameters integrated out.
        inner: lower factors of each person's precision, entries [level].
        coupling: L^-1 times a person's products with the rest, per row of `Arrangement.inner`.
        inner_half: L^-1 times what pulls a person's effects.
        factor: lower factor of the rest's precision, people eliminated.
        half: its inverse times what pulls the rest.
    """

    log_evidence: Float[Array, ""]
    inner: list[list[Array]]
    coupling: list[Float[Array, "level rest"]]
    inner_half: list[Float[Array, " level"]]
    factor: Float[Array, "rest rest"]
    half: Float[Array, " rest"]


def solve(cells: Cells, spread: Spread) -> tuple[Solution, CellSums]:
    """Integrate b out, or rather all that is needed to do so and to draw it back."""
    layout, sums = cells.arrangement, cell_sums(cells, spread)
    size, own = len(cells.slope), sorted(layout.inner)
    prior, between = spread.precision()
    away = cells.mean - cells.reference
    pulled = spread.weigh(away)
    levels = len(layout.inner[own[0]]) if own else 1
    columns = [jnp.asarray(matrix) for matrix in layout.columns]

    def by_level(values: Array) -> Array:
        return values.reshape(levels, -1).sum(1)

    inner = small.cholesky(
        [
            [by_level(sums.entry(a, b)) + _prior_of(prior, between, layout, a, b) for b in own[: i + 1]]
            for i, a in enumerate(own)
        ]
    )
    across = [
        jnp.concatenate(
            [_across(sums, a, matrix, b, levels, size) for b, matrix in enumerate(columns)], axis=1
        )
        for a in own
    ]
    lifted = [[entry[:, None] for entry in row] for row in inner]
    coupling = small.forward_solve(lifted, across) if own else []
    right = [by_level(sums.pull[a]) + pulled[layout.inner[a]] for a in own]
    inner_half = small.forward_solve(inner, right) if own else []
    precision, toward = _of_rest(columns, sums, levels, size)
    precision = precision + jnp.diag(prior[layout.rest]) - sum(y.T @ y for y in coupling)
    toward = toward + pulled[layout.rest] - sum(y.T @ h for y, h in zip(coupling, inner_half, strict=True))
    factor = jnp.linalg.cholesky(precision)
    half = solve_triangular(factor, toward, lower=True)
    log_evidence = (
        (cells.level + sums.constant).sum()
        - spread.log_scale()
        - sum(jnp.log(inner[i][i]).sum() for i in range(len(own)))
        - jnp.log(jnp.diagonal(factor)).sum()
        + (sum((h**2).sum() for h in inner_half) + (half**2).sum() - (pulled * away).sum()) / 2
    )
    return Solution(log_evidence, inner, coupling, inner_half, factor, half), sums


def _prior_of(prior: Array, between: Array | None, layout: Arrangement, a: int, b: int) -> Array | float:
    """Prior precision between a level's effects on parameters ``a`` and ``b``."""
    if a == b:
        return prior[layout.inner[a]]
    return 0.0 if between is None else between


def _across(sums: CellSums, a: int, matrix: Array, b: int, levels: int, size: int) -> Array:
    """Each level's products of its effect on parameter ``a`` with the columns of parameter ``b``."""
    if b >= size:
        return jnp.zeros((levels, matrix.shape[2]))
    weight = sums.entry(a, b).reshape(levels, -1)
    return weight @ matrix[0] if matrix.shape[0] == 1 else jnp.einsum("ls,lsp->lp", weight, matrix)


def _of_rest(columns: list[Array], sums: CellSums, levels: int, size: int) -> tuple[Array, Array]:
    """X' W X and X' pull of the rest."""
    shared = columns[0].shape[0] == 1
    rows = [matrix.reshape(-1, matrix.shape[2]) for matrix in columns]

    def total(values: Array) -> Array:
        return values.reshape(levels, -1).sum(0) if shared else values

    blocks = [[jnp.zeros((a.shape[1], b.shape[1])) for b in rows] for a in rows]
    for a in range(size):
        for b in range(a + 1):
            blocks[a][b] = rows[a].T @ (total(sums.entry(a, b))[:, None] * rows[b])
            blocks[b][a] = blocks[a][b].T
    toward = [
        matrix.T @ total(sums.pull[a]) if a < size else jnp.zeros(matrix.shape[1])
        for a, matrix in enumerate(rows)
    ]
    return jnp.block(blocks), jnp.concatenate(toward)


def locations_of(
    cells: Cells, solution: Solution, standard: Float[Array, " location"] | None = None
) -> Float[Array, " location"]:
    """All of b from standard normals; its mean without them."""
    layout = cells.arrangement
    standard = jnp.zeros_like(cells.mean) if standard is None else standard
    rest = solve_triangular(solution.factor, solution.half + standard[layout.rest], lower=True, trans=1)
    b = cells.reference.at[layout.rest].add(rest)
    own = sorted(layout.inner)
    if not own:
        return b
    right = [
        half - coupling @ rest + standard[layout.inner[a]]
        for a, half, coupling in zip(own, solution.inner_half, solution.coupling, strict=True)
    ]
    for a, effects in zip(own, small.backward_solve(solution.inner, right), strict=True):
        b = b.at[layout.inner[a]].add(effects)
    return b
