"""The two parts of a Gaussian log density with an MA(1)'s covariance: w' T^-1 w and log det T.

T is tridiagonal, 1 + theta1^2 on and -theta1 beside the diagonal.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Float

from bayestissue.oscillator.entire import sinc_root

Columns = tuple[Float[Array, "block #impact lane"], ...]


def eigenvalues(theta1: Array, spread: Array) -> Array:
    """1 + theta1^2 - 2 theta1 cos(j pi / (N + 1)) with spread = 2 - 2 cos(j pi / (N + 1))."""
    return (1 - theta1) ** 2 + theta1 * spread


@jax.custom_jvp
def quadratic_form(
    coefficients: tuple[Float[Array, " impact"], ...],
    theta1: Float[Array, " impact"],
    columns: Columns,
    spread: Float[
        Array,
        (
            block  # impact lane
        ),
    ],
) -> Float[Array, " impact"]:
    """sum_j W_j^2 / l_j with W the sum of coefficient times column, and l the eigenvalues of T.

    Value and first derivatives come from one pass over the data.

    Args:
        coefficients: one per column, for each impact.
        theta1: moving-average coefficient of each impact.
        columns: transformed data in blocks of frequencies.
        spread: 2 - 2 cos(j pi / (N + 1)) in the same blocks.
    """

    def block(total: Array, part: tuple[Columns, Array]) -> tuple[Array, None]:
        w, _, over = _weighted(coefficients, theta1, *part)
        return total + w * over, None

    return jax.lax.scan(block, _zeros(theta1, columns), (columns, spread))[0].sum(-1)


def _quadratic_form_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    coefficients, theta1, columns, spread = primals
    d_coefficients, d_theta1, d_columns, d_spread = tangents
    value, by_coefficient, by_theta1 = _form_and_slopes(*primals)
    change = jnp.zeros_like(value)
    for slope, d in zip((*by_coefficient, by_theta1), (*d_coefficients, d_theta1), strict=True):
        change = change if isinstance(d, SymbolicZero) else change + slope * d
    if not isinstance(d_spread, SymbolicZero):
        raise TypeError("the frequencies are not something to differentiate by")
    for coefficient, d in zip(coefficients, d_columns, strict=True):
        if not isinstance(d, SymbolicZero):
            over = _weighted(coefficients, theta1, columns, spread)[2]
            change = change + 2 * coefficient * (over * d).sum((0, -1))
    return value, change


quadratic_form.defjvp(_quadratic_form_jvp, symbolic_zeros=True)


def _form_and_slopes(
    coefficients: tuple[Array, ...], theta1: Array, columns: Columns, spread: Array
) -> tuple[Array, tuple[Array, ...], Array]:
    def block(totals: Any, part: Any) -> Any:
        w, s, over = _weighted(coefficients, theta1, *part)
        bend = over**2 * (2 * (1 - theta1)[:, None] - s)
        terms = (w * over, *(2 * over * column for column in part[0]), bend)
        return tuple(total + term for total, term in zip(totals, terms, strict=True)), None

    start = (_zeros(theta1, columns),) * (len(columns) + 2)
    totals = jax.lax.scan(block, start, (columns, spread), unroll=2)[0]
    value, *slopes, by_theta1 = (total.sum(-1) for total in totals)
    return value, tuple(slopes), by_theta1


def _weighted(
    coefficients: tuple[Array, ...], theta1: Array, columns: Columns, spread: Array
) -> tuple[Array, Array, Array]:
    """W, the spread and W / l, for one block or for all of them."""
    w = sum(c[:, None] * column for c, column in zip(coefficients, columns, strict=True))
    return w, spread, w / eigenvalues(theta1[:, None], spread)  # type: ignore[return-value]


def _zeros(theta1: Array, columns: Columns) -> Array:
    return jnp.zeros((theta1.shape[0], columns[0].shape[-1]), columns[0].dtype)


def log_determinant(theta1: Array, count: Array) -> Array:
    """Log det T = log(1 + theta1^2 + theta1^4 + ... + theta1^(2 N)) for N = count values.

    The geometric sum (1 - theta1^(2N+2)) / (1 - theta1^2) with its value and derivatives kept at
    |theta1| = 1, and right beyond it. Arguments broadcast.
    """
    square = theta1**2
    small = square < 0.25
    little = jnp.where(small, square, 0.0)
    log_square = jnp.log(jnp.where(small, 1.0, square))
    near = (
        count * log_square / 2
        + jnp.log(count + 1.0)
        + _log_sinhc((count + 1) * log_square / 2)
        - _log_sinhc(log_square / 2)
    )
    return jnp.where(small, jnp.log1p(-(little ** (count + 1))) - jnp.log1p(-little), near)


def _log_sinhc(y: Array) -> Array:
    """log(sinh(y) / y), even and smooth at 0."""
    small = jnp.abs(y) < 0.99
    size = jnp.where(small, 1.0, jnp.abs(y))
    away = size + jnp.log1p(-jnp.exp(-2 * size)) - jnp.log(2 * size)
    return jnp.where(small, jnp.log(sinc_root(-(jnp.where(small, y, 0.0) ** 2))), away)
