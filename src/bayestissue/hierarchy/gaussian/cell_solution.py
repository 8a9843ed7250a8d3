"""All locations given the standard deviations, for many impacts: people first, one by one, then the rest."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import solve_triangular
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.cell_sums import CellSums, cell_sums
from bayestissue.hierarchy.gaussian.cells import Arrangement, Cells
from bayestissue.hierarchy.population import Covariances
from bayestissue.likelihood import small


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


def solve(cells: Cells, spread: Covariances) -> tuple[Solution, CellSums]:
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
