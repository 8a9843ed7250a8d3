"""Errors of the measuring chain that enter a trace linearly, integrated out in closed form.

A trace is y = f + sum_a e_a q_a + noise, with the errors e_a normal about 0 and independent, q_a known
columns, and noise with covariance sigma^2 T. All that the density needs of the data are the products of
the columns under T^-1, y - f being column 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.likelihood import small

LOG_2PI = 1.8378770664093453


class Products(NamedTuple):
    """What is left of a set of traces once the shape of each is given.

    Attributes:
        gram: products of column a with column b under T^-1, as rows of entries [impact].
        log_determinant: log det T.
        n_values: number of values of each trace.
    """

    gram: tuple[tuple[Array, ...], ...]
    log_determinant: Float[Array, " impact"]
    n_values: Float[Array, " impact"]


def gram(parts: tuple[Array, ...], weight: Array) -> tuple[tuple[Array, ...], ...]:
    """The sums of part a times part b times weight over the last axis, as rows of entries.

    Args:
        parts: residual and error columns, each [impact, value], 0 where a trace has no value.
        weight: 1 over the eigenvalue of T that belongs to each value; broadcasts with the parts.
    """
    size = len(parts)
    over = [part * weight for part in parts]
    lower = [[(over[a] * parts[b]).sum(-1) for b in range(a + 1)] for a in range(size)]
    return tuple(tuple(lower[max(a, b)][min(a, b)] for b in range(size)) for a in range(size))


def marginal_log_likelihood(
    products: Products, log_sigma: Float[Array, " impact"], error_sd: Float[Array, "impact error"]
) -> Float[Array, " impact"]:
    """Log density of each trace with its errors integrated out.

    -(N log(2 pi sigma^2) + log det T + log det M + G_00 / sigma^2 - h' M^-1 h) / 2 with
    M = 1 + S G S / sigma^2, h = S G_.0 / sigma^2 and S the standard deviations of the errors: the matrix
    determinant lemma and the Woodbury identity.

    Args:
        products: of residual and error columns.
        log_sigma: log of the noise's standard deviation.
        error_sd: standard deviation of each error; 0 where there is none.
    """
    factor, right, precision = _system(products, log_sigma, error_sd)
    explained = sum(value**2 for value in small.forward_solve(factor, right))
    scale = products.n_values * (LOG_2PI + 2 * log_sigma) + products.log_determinant
    return -(scale + products.gram[0][0] * precision - explained) / 2 - small.log_diagonal(factor)


def from_lower_entries(entries: Sequence[Array]) -> tuple[tuple[Array, ...], ...]:
    """The rows of a symmetric matrix from those of its lower triangle."""
    size = int((8 * len(entries) + 1) ** 0.5) // 2
    return tuple(
        tuple(entries[max(a, b) * (max(a, b) + 1) // 2 + min(a, b)] for b in range(size)) for a in range(size)
    )


def draw_errors(
    key: Array,
    products: Products,
    log_sigma: Float[Array, " impact"],
    error_sd: Float[Array, "impact error"],
) -> Float[Array, "impact error"]:
    """The errors given the trace and everything else: normal with mean S M^-1 h and covariance S M^-1 S."""
    factor, right, _ = _system(products, log_sigma, error_sd)
    standard = jax.random.normal(key, error_sd.shape)
    mean = small.forward_solve(factor, right)
    whole = [value + standard[..., a] for a, value in enumerate(mean)]
    return error_sd * jnp.stack(small.backward_solve(factor, whole), axis=-1)


def _system(
    products: Products, log_sigma: Array, error_sd: Array
) -> tuple[list[list[Array]], list[Array], Array]:
    precision = jnp.exp(-2 * log_sigma)
    entries, number = products.gram, error_sd.shape[-1]
    scale = [error_sd[..., a] for a in range(number)]
    matrix = [
        [scale[a] * scale[b] * entries[a + 1][b + 1] * precision + float(a == b) for b in range(number)]
        for a in range(number)
    ]
    right = [scale[a] * entries[a + 1][0] * precision for a in range(number)]
    return small.cholesky(matrix), right, precision
