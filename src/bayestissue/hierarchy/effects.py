"""What formulas are of: log K, log C and an element's further parameters; an impact's covariance."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

RESPONSES = ("K", "C")


def parameter_of(response: str) -> str:
    """The impact's parameter that a formula is of, by its name in the hierarchy: K, ``log_thickness_m``."""
    return response if response in RESPONSES else f"log_{response}"


def intercept(parameter: str) -> str:
    """The name of an impact's parameter at the reference row; without covariates that is the mean of all."""
    return f"intercept_{parameter}" if parameter in RESPONSES else f"{parameter}_mean"


def sd_impact(parameter: str) -> str:
    """The name of its standard deviation between impacts."""
    return f"sd_impact_{parameter}" if parameter in RESPONSES else f"sd_{parameter}"


def cholesky_factor(
    sd_K: Float[Array, "*batch"], sd_C: Float[Array, "*batch"], correlation: Float[Array, "*batch"] | float
) -> Float[Array, "*batch 2 2"]:
    """The lower Cholesky factor of [[sd_K², r sd_K sd_C], [r sd_K sd_C, sd_C²]]."""
    zero = jnp.zeros_like(sd_K)
    first = jnp.stack([sd_K, zero], axis=-1)
    second = jnp.stack([sd_C * correlation, sd_C * jnp.sqrt(1 - jnp.square(correlation))], axis=-1)
    return jnp.stack([first, second], axis=-2)
