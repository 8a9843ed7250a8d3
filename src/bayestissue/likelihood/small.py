"""Cholesky factors of many small matrices at once, unrolled over rows and columns.

A matrix is a tuple of rows, each entry an array over impacts. Four by four, this is a few dozen
elementwise operations that a compiler fuses, where a batched library call would visit the impacts one by
one; and its derivatives are as cheap.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

Matrix = Sequence[Sequence[Array]]
Vector = Sequence[Array]


def cholesky(matrix: Matrix) -> list[list[Array]]:
    """The lower factor L of a symmetric positive definite matrix, matrix = L L'; only L's own entries."""
    factor: list[list[Array]] = []
    for i in range(len(matrix)):
        row: list[Array] = []
        for j in range(i):
            rest = matrix[i][j] - _dot(row, factor[j], j)
            row.append(rest / factor[j][j])
        row.append(jnp.sqrt(matrix[i][i] - _dot(row, row, i)))
        factor.append(row)
    return factor


def forward_solve(factor: Matrix, right: Vector, first: int = 0) -> list[Array]:
    """L^-1 right, from entry ``first`` on, before which ``right`` is zero and has no entries."""
    solved: list[Array] = []
    for i in range(len(right)):
        row = factor[first + i]
        solved.append((right[i] - _dot(row[first:], solved, i)) / row[first + i])
    return solved


def backward_solve(factor: Matrix, right: Vector) -> list[Array]:
    """L'^-1 right."""
    size = len(right)
    solved: list[Array] = [right[-1]] * size
    for i in reversed(range(size)):
        rest = right[i]
        for j in range(i + 1, size):
            rest = rest - factor[j][i] * solved[j]
        solved[i] = rest / factor[i][i]
    return solved


def log_diagonal(factor: Matrix) -> Array:
    """Log of the product of the factor's diagonal: half the log determinant of the matrix."""
    product = factor[0][0]
    for i in range(1, len(factor)):
        product = product * factor[i][i]
    return jnp.log(product)


def times(matrix: Matrix, vector: Vector) -> list[Array]:
    """Matrix times vector."""
    return [_dot(row, vector, len(vector)) for row in matrix]


def entries(matrix: Array) -> list[list[Array]]:
    """A matrix on the last two axes as rows of entries."""
    size = matrix.shape[-1]
    return [[matrix[..., i, j] for j in range(size)] for i in range(matrix.shape[-2])]


def dot(left: Vector, right: Vector) -> Array:
    """The sum of products of entries, as many as the shorter of the two has."""
    return _dot(left, right, min(len(left), len(right)))


def _dot(left: Vector, right: Vector, count: int) -> Array:
    if not count:
        return jnp.zeros(())
    total = left[0] * right[0]
    for k in range(1, count):
        total = total + left[k] * right[k]
    return total
