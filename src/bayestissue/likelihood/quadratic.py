"""What a Gaussian log density with an MA(1)'s covariance takes: eigenvalues and log det T, and sums.

T is tridiagonal, 1 + theta1^2 on and -theta1 beside the diagonal.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

# (t coth t - 1) / t^2 in powers of t^2: 2^(2k) B_2k / (2k)! with Bernoulli's numbers.
_COTH = (
    *(1 / 3, -1 / 45, 2 / 945, -1 / 4725, 2 / 93555, -1382 / 638512875, 4 / 18243225),
    *(-3617 / 162820783125, 87734 / 38979295480125),
)


def eigenvalues(theta1: Array, spread: Array) -> Array:
    """1 + theta1^2 - 2 theta1 cos(j pi / (N + 1)) with spread = 2 - 2 cos(j pi / (N + 1))."""
    return (1 - theta1) ** 2 + theta1 * spread


@jax.custom_jvp
def sums_over_frequencies(terms: tuple[Array, ...]) -> tuple[Array, ...]:
    """The sum over block and lane of every term, all in one pass over what they share.

    The blocks are summed first, lane by lane: that loop is short enough to be unrolled, and then runs over
    the lanes in vector registers. One reduction of several operands is one loop, several are several.

    Args:
        terms: two or more, each [block, impact, lane].
    """
    zeros = (jnp.zeros((), terms[0].dtype),) * len(terms)
    lanes = tuple(jax.lax.reduce(terms, zeros, _plus, (0,)))
    return tuple(jax.lax.reduce(lanes, zeros, _plus, (1,)))


def _plus(a: tuple[Array, ...], b: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(x + y for x, y in zip(a, b, strict=True))


@sums_over_frequencies.defjvp
def _sums_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    # JAX's own derivative of a reduction of several operands is far slower than that of plain sums.
    return sums_over_frequencies(*primals), tuple(d.sum((0, -1)) for d in tangents[0])


@jax.custom_jvp
def log_determinant(theta1: Array, count: Array) -> Array:
    """Log det T = log(1 + theta1^2 + theta1^4 + ... + theta1^(2 N)) for N = count values.

    The geometric sum (1 - theta1^(2N+2)) / (1 - theta1^2) with its value and derivatives kept at
    |theta1| = 1, and right beyond it. Arguments broadcast; only theta1 is one to differentiate by.
    """
    size = jnp.abs(theta1)
    # The ratio is N + 1 where both of its parts vanish.
    decay = jnp.maximum(jnp.abs(jnp.log(size)), 1e-200)
    ratio = jnp.expm1(-2 * (count + 1) * decay) / jnp.expm1(-2 * decay)
    return 2 * count * jnp.log(jnp.maximum(size, 1.0)) + jnp.log(ratio)


@log_determinant.defjvp
def _log_determinant_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    return log_determinant(*primals), _log_determinant_slope(*primals) * tangents[0]


def _log_determinant_slope(theta1: Array, count: Array) -> Array:
    """The derivative by theta1: the sum of 2k theta1^(2k-1) over that of theta1^(2k), k = 0 ... N.

    With a = -log|theta1| it is (N - (N+1) coth((N+1) a) + coth a) / theta1, by series near a = 0. Beyond 1
    it follows from the sums being the same read backwards.
    """
    terms, size = count + 1, jnp.abs(theta1)
    beyond = size > 1
    inner = jnp.where(beyond, 1 / jnp.where(beyond, size, 1.0), size)
    decay = -jnp.log(jnp.where(inner > 0, inner, 1e-300))
    near = terms * decay < 0.5
    little = jnp.where(near, decay, 0.0)
    bend = terms**2 * _coth_series((terms * little) ** 2) - _coth_series(little**2)
    by_log = count - little * bend
    far = jnp.where(near, 0.5, inner)
    last = jnp.exp(-2 * count * jnp.where(near, 1.0, decay))
    over_square = 2 / ((1 - far) * (1 + far)) - 2 * terms * last / (1 - last * far**2)
    by_log_outside = 2 * count - jnp.where(near, by_log, far**2 * over_square)
    divided = jnp.where(beyond, by_log_outside, by_log) / jnp.where(near | beyond, theta1, 1.0)
    return jnp.where(near | beyond, divided, theta1 * over_square)


def _coth_series(square: Array) -> Array:
    total = jnp.full_like(square, _COTH[-1])
    for coefficient in _COTH[-2::-1]:
        total = total * square + coefficient
    return total
