"""The two responses, and the covariance of an impact's."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

RESPONSES = ("K", "C")


def cholesky_factor(
    sd_K: Float[Array, "*batch"], sd_C: Float[Array, "*batch"], correlation: Float[Array, "*batch"] | float
) -> Float[Array, "*batch 2 2"]:
    """The lower Cholesky factor of [[sd_K², r sd_K sd_C], [r sd_K sd_C, sd_C²]]."""
    zero = jnp.zeros_like(sd_K)
    first = jnp.stack([sd_K, zero], axis=-1)
    second = jnp.stack([sd_C * correlation, sd_C * jnp.sqrt(1 - jnp.square(correlation))], axis=-1)
    return jnp.stack([first, second], axis=-2)
