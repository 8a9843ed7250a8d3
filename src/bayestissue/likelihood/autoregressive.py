"""Noise of a recorder whose samples follow each other: first-order autoregressive, e_t = rho e_{t-1} + w_t.

Stationary, with independent w_t ~ N(0, sigma^2), so that e has the covariance sigma^2 T with
T_st = rho^|s - t| / (1 - rho^2), whose inverse is tridiagonal and has the determinant 1 - rho^2 (Box and
Jenkins, Time Series Analysis, section 7.4). sigma is that of w: what the data tell of it hardly depends on
rho, since sigma and rho share no information but the first sample's 2 rho / (1 - rho^2) against 2 N for
log sigma itself; the standard deviation of e, sigma / (1 - rho^2)^1/2, would follow rho. a = artanh rho
stands for rho everywhere, since 1 - rho^2 = 1 / cosh^2 a loses no digits near rho = 1.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

_LOG_2 = 0.6931471805599453


def whitened(
    part: Float[Array, "impact sample"],
    atanh_correlation: Float[Array, " impact"],
    inside: Bool[Array, "impact sample"],
) -> Float[Array, "impact sample"]:
    """(1 - rho^2)^1/2 p_0 and p_t - rho p_{t-1}: products of two such are those of the parts under T^-1.

    Args:
        part: residual or error column, 0 past a row's end.
        atanh_correlation: a.
        inside: where there is a sample; what comes after stays 0.
    """
    a = atanh_correlation[:, None]
    follows = part[:, 1:] - jnp.tanh(a) * part[:, :-1]
    return jnp.where(inside, jnp.concatenate([part[:, :1] / jnp.cosh(a), follows], axis=1), 0.0)


def log_determinant(atanh_correlation: Float[Array, " impact"]) -> Float[Array, " impact"]:
    """Of T: -log(1 - rho^2) = 2 log cosh a."""
    size = jnp.abs(atanh_correlation)
    return 2 * (size + jnp.log1p(jnp.exp(-2 * size)) - _LOG_2)


def offset_sd(
    error_sd: Float[Array, "impact error"],
    quiet: Bool[Array, " impact"],
    atanh_correlation: Float[Array, " impact"],
    column: int,
) -> Float[Array, "impact error"]:
    """Standard deviations of errors, that of a mean of samples by ((1 + rho) / (1 - rho))^1/2 = e^a larger.

    Args:
        error_sd: as under white noise.
        quiet: where the error in ``column`` is that of the mean of many samples.
        atanh_correlation: a.
        column: which error that is.
    """
    factor = jnp.where(quiet, jnp.exp(atanh_correlation), 1.0)
    return error_sd.at[..., column].multiply(factor)


def correlated(
    standard: Float[Array, "*batch impact sample"], atanh_correlation: Float[Array, " impact"]
) -> Float[Array, "*batch impact sample"]:
    """Noise over sigma from standard normals, one a sample: the inverse of `whitened`."""
    rho = jnp.tanh(atanh_correlation)
    first = standard[..., 0] * jnp.cosh(atanh_correlation)

    def follow(before: Array, shock: Array) -> tuple[Array, Array]:
        now = rho * before + shock
        return now, now

    _, later = jax.lax.scan(follow, first, jnp.moveaxis(standard[..., 1:], -1, 0))
    return jnp.concatenate([first[..., None], jnp.moveaxis(later, 0, -1)], axis=-1)
