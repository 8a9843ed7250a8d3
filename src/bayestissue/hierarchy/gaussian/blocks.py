"""Cholesky factors and solves of many small matrices at once, [row, column, *block], in numpy or JAX.

Rows and columns come first and are unrolled, so that every operation runs along the blocks: a library call
would visit the matrices one by one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Num

Array = Any  # of numpy or JAX: what comes in decides what comes out


def cholesky(matrix: Float[Array, "row row *block"]) -> Float[Array, "row row *block"]:
    """The lower factor L of symmetric positive definite matrices, matrix = L L'."""
    xp, left, columns = matrix.__array_namespace__(), matrix, []
    for k in range(len(matrix)):
        column = left[:, 0] / xp.sqrt(left[0, 0])
        left = left[1:, 1:] - column[1:, None] * column[None, 1:]
        columns.append(xp.concat([xp.zeros_like(column[:1])] * k + [column]))
    return xp.stack(columns, axis=1) if columns else matrix


def solve_lower(
    factor: Float[Array, "row row *block"], right: Num[Array, " row *right"]
) -> Float[Array, " row *right"]:
    """L^-1 right; the blocks are the last axes of ``right`` too, and other axes may come before them."""
    solved: list[Array] = []
    for i in range(len(factor)):
        rest = right[i]
        for j, before in enumerate(solved):
            rest = rest - factor[i, j] * before
        solved.append(rest / factor[i, i])
    return factor.__array_namespace__().stack(solved) if solved else right


def solve_upper(
    factor: Float[Array, "row row *block"], right: Num[Array, " row *right"]
) -> Float[Array, " row *right"]:
    """L'^-1 right, as `solve_lower`."""
    solved: list[Array] = []
    for i in reversed(range(len(factor))):
        rest = right[i]
        for j, after in zip(range(i + 1, len(factor)), solved, strict=True):
            rest = rest - factor[j, i] * after
        solved.insert(0, rest / factor[i, i])
    return factor.__array_namespace__().stack(solved) if solved else right


def inverse_factor(factor: Float[Array, "row row *block"]) -> Float[Array, "row row *block"]:
    """L^-1, so that (L^-1)' L^-1 is the inverse of L L'."""
    size = len(factor)
    return solve_lower(factor, np.eye(size).reshape(size, size, *[1] * (factor.ndim - 2)))


def log_diagonal(factor: Float[Array, "row row *block"]) -> Float[Array, " *block"]:
    """Log of the product of the factor's diagonal: half the log determinant of the matrix."""
    xp = factor.__array_namespace__()
    return sum((xp.log(factor[i, i]) for i in range(len(factor))), xp.zeros(()))


def product(
    left: Float[Array, "row inner *#block"], right: Float[Array, "inner column *#block"]
) -> Float[Array, "row column *block"]:
    """Of matrices; written as a sum, since a small product is a call each."""
    return (left[:, :, None] * right[None]).sum(1)


def times(
    matrix: Float[Array, "row column *#block"], vector: Float[Array, "column *#block"]
) -> Float[Array, " row *block"]:
    """Matrices times vectors."""
    return (matrix * vector[None]).sum(1)


def outer(left: Float[Array, " row *block"], right: Float[Array, " column *block"]) -> Array:
    """Products of every entry with every entry."""
    return left[:, None] * right[None]


def with_axes(values: Array, first: int, axes: int) -> Array:
    """The same with so many axes behind the ``first``, those that are missing of length one."""
    missing = (1,) * (axes + first - values.ndim)
    return values.reshape(*values.shape[:first], *missing, *values.shape[first:])


def transposed(matrix: Float[Array, "row column *block"]) -> Float[Array, "column row *block"]:
    """Rows and columns exchanged."""
    return matrix.swapaxes(0, 1)
