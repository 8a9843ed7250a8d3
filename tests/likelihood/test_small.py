from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from scipy.linalg import solve_triangular

from bayestissue.model.likelihood import small

RNG = np.random.default_rng(3)
ROOTS = RNG.normal(size=(5, 4, 4))
MATRICES = ROOTS @ ROOTS.swapaxes(1, 2) + 0.1 * np.eye(4)
RIGHT = RNG.normal(size=(5, 4))


def entries(matrices: jax.Array | np.ndarray) -> jax.Array:
    """With the axes of rows and columns first."""
    return jnp.moveaxis(jnp.asarray(matrices), (-2, -1), (0, 1))


def whole(factor: list[list[jax.Array]]) -> np.ndarray:
    full = np.zeros_like(MATRICES)
    for i, row in enumerate(factor):
        for j, value in enumerate(row):
            full[:, i, j] = value
    return full


def test_the_factor_is_that_of_the_library() -> None:
    factor = small.cholesky(entries(MATRICES))
    assert [len(row) for row in factor] == [1, 2, 3, 4]
    # A few dozen roundings of numbers of the order of the matrix, over a condition number below 1000.
    assert_allclose(whole(factor), np.linalg.cholesky(MATRICES), atol=1e-12)
    logs = np.linalg.slogdet(MATRICES)[1] / 2
    assert_allclose(small.log_diagonal(factor), logs, atol=1e-12)


def test_both_solutions_are_those_of_the_library() -> None:
    factor = small.cholesky(entries(MATRICES))
    right = [jnp.asarray(RIGHT[:, a]) for a in range(4)]
    for solve, transposed in ((small.solve_lower, 0), (small.solve_upper, 1)):
        for i, full in enumerate(whole(factor)):
            direct = solve_triangular(full, RIGHT[i], lower=True, trans=transposed)
            assert_allclose(np.stack(solve(factor, right), axis=1)[i], direct, rtol=1e-10, atol=1e-12)


def test_times_is_a_product_of_matrix_and_vector() -> None:
    vector = [jnp.asarray(RIGHT[:, a]) for a in range(4)]
    made = np.stack(small.times(entries(MATRICES), vector), axis=1)
    assert_allclose(made, np.einsum("iab,ib->ia", MATRICES, RIGHT), rtol=1e-13, atol=1e-13)


def test_slopes_of_the_determinant_are_the_inverse() -> None:
    def half_log_determinant(matrix: jax.Array) -> jax.Array:
        return small.log_diagonal(small.cholesky(entries(matrix)))

    slope = jax.grad(half_log_determinant)(jnp.asarray(MATRICES[0]))
    # Only the lower triangle is read: off the diagonal it carries both halves of the slope.
    inverse = np.linalg.inv(MATRICES[0])
    expected = np.tril(inverse) - np.diag(np.diag(inverse)) / 2
    assert_allclose(slope, expected, rtol=1e-9, atol=1e-11)
