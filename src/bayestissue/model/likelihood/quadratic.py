"""What a Gaussian log density with an MA(1)'s covariance takes: eigenvalues and log det T, and sums.

T is tridiagonal, 1 + theta1^2 on and -theta1 beside the diagonal.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from bayestissue.mechanics.oscillator.entire import sinc_root


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


def log_determinant(theta1: Array, count: Array) -> Array:
    """Log det T = log(1 + theta1^2 + theta1^4 + ... + theta1^(2 N)) for N = count values.

    With a = log |theta1| that is N a + log(sinh((N + 1) a) / sinh a), smooth where a is 0. Away from there
    it is the geometric sum (1 - q^(N+1)) / (1 - q) of q = theta1^2, beyond 1 read backwards. Arguments
    broadcast.
    """
    square, terms = theta1**2, count + 1
    beyond = square > 1
    inner = jnp.where(beyond, 1 / jnp.where(beyond, square, 1.0), square)
    near = -terms * jnp.log(jnp.maximum(inner, 1e-300)) < 1
    a = jnp.log(jnp.where(near, square, 1.0)) / 2
    by_sines = count * a + jnp.log(terms * sinc_root(-((terms * a) ** 2)) / sinc_root(-(a**2)))
    far = jnp.where(near, 0.5, inner)
    by_sum = jnp.log1p(-(far**terms)) - jnp.log1p(-far)
    reversed_ = count * jnp.log(jnp.where(beyond & ~near, square, 1.0))
    return jnp.where(near, by_sines, by_sum + reversed_)
