"""Algebra of many small matrices at once, written out entry by entry, in numpy or JAX.

A vector is a sequence of entries and a matrix one of rows, each entry an array over the blocks; an array with
these axes first is such a sequence too. Every operation runs along the blocks, and XLA makes one loop of
several: a library call would visit the matrices one by one, and whole matrices put together between two steps
would all go through memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import add, mul
from typing import Any

import numpy as np

LOG_2PI = float(np.log(2 * np.pi))
Entry = Any  # an array of numpy or JAX, or a number
Vector = Sequence[Entry] | Any
Matrix = Sequence[Vector] | Any
# Row i of a lower triangular matrix has i + 1 entries.
Triangle = list[list[Entry]]


def dot(left: Vector, right: Vector) -> Entry:
    """Sum of products as far as the shorter one reaches."""
    terms = list(map(mul, left, right))
    return reduce(add, terms) if terms else 0.0


def cholesky(matrix: Matrix) -> Triangle:
    """The lower factor L of symmetric positive definite matrices, matrix = L L'; their lower half is read."""
    factor: Triangle = []
    for i in range(len(matrix)):
        row: list[Entry] = []
        for above in factor:
            row.append((matrix[i][len(row)] - dot(row, above)) / above[-1])
        square = matrix[i][i] - dot(row, row)
        factor.append([*row, square.__array_namespace__().sqrt(square)])
    return factor


def solve_lower(factor: Triangle, right: Vector) -> list[Entry]:
    """L^-1 right; the entries of ``right`` may have axes before those of the blocks."""
    solved: list[Entry] = []
    for row, value in zip(factor, right, strict=True):
        solved.append((value - dot(solved, row)) / row[-1])
    return solved


def solve_upper(factor: Triangle, right: Vector) -> list[Entry]:
    """L'^-1 right, as `solve_lower`."""
    solved: list[Entry] = []
    for i in reversed(range(len(factor))):
        below = [row[i] for row in factor[i + 1 :]]
        solved.insert(0, (right[i] - dot(solved, below)) / factor[i][i])
    return solved


def inverse_factor(factor: Triangle) -> Triangle:
    """L^-1, so that (L^-1)' L^-1 is the inverse of L L'."""
    inverse: Triangle = []
    for i, row in enumerate(factor):
        over = 1 / row[i]
        columns = [[above[j] for above in inverse[j:]] for j in range(i)]
        inverse.append([*(-over * dot(row[j:], column) for j, column in enumerate(columns)), over])
    return inverse


def inverse(matrix: Matrix) -> list[list[Entry]]:
    """Of symmetric positive definite matrices."""
    root = inverse_factor(cholesky(matrix))
    return symmetric(len(root), lambda a, b: dot([row[a] for row in root[a:]], [row[b] for row in root[a:]]))


def normal_log_density(deviation: Vector, covariance: Matrix) -> Entry:
    """Log density of normal vectors, so far from their mean."""
    factor = cholesky(covariance)
    half = solve_lower(factor, deviation)
    return -(dot(half, half) + len(half) * LOG_2PI) / 2 - log_diagonal(factor)


def log_diagonal(factor: Triangle) -> Entry:
    """Log of the product of the factor's diagonal: half the log determinant of the matrix."""
    diagonal = [row[-1] for row in factor]
    if not diagonal:
        return np.zeros(())
    # One log instead of one for each: a dozen standard deviations are far from where products overflow.
    product = reduce(mul, diagonal)
    return product.__array_namespace__().log(product)


def times(matrix: Matrix, vector: Vector) -> list[Entry]:
    """Matrices times vectors; of a lower triangle its own entries."""
    return [dot(row, vector) for row in matrix]


def turned_times(triangle: Triangle, vector: Vector) -> list[Entry]:
    """The transpose of lower triangles times vectors."""
    return [dot([row[a] for row in triangle[a:]], vector[a:]) for a in range(len(triangle))]


def product(left: Matrix, right: Matrix) -> list[list[Entry]]:
    """Of matrices, the left one possibly a lower triangle."""
    return [times(transposed(right), row) for row in left]


def transposed(matrix: Matrix) -> list[list[Entry]]:
    """Rows and columns exchanged."""
    return [list(column) for column in zip(*matrix, strict=True)]


def symmetric(size: int, entry: Callable[[int, int], Entry]) -> list[list[Entry]]:
    """Of entries that are made once for a >= b."""
    lower = [[entry(a, b) for b in range(a + 1)] for a in range(size)]
    return [[lower[max(a, b)][min(a, b)] for b in range(size)] for a in range(size)]


def stacked(matrix: Matrix) -> Any:
    """One array with the axes of rows and columns first."""
    xp = matrix[0][0].__array_namespace__()
    return xp.stack([xp.stack(xp.broadcast_arrays(*row)) for row in matrix])
