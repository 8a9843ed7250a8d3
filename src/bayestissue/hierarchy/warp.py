"""A smooth map that makes a skewed distribution of one parameter normal."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array


class Warp(NamedTuple):
    """z = location + scale sinh(asinh(y) + skew), increasing and smooth, y standard normal.

    The sinh-arcsinh family (Jones and Pewsey 2009, Biometrika 96) with normal tails: far out the map has
    slope scale e^skew on one side and scale e^-skew on the other, as a distribution does that ends at a
    wall and thins out slowly away from it.

    Attributes:
        location, scale: of z where y is 0 and skew is 0.
        skew: 0 for a line.
    """

    location: Array
    scale: Array
    skew: Array

    def __call__(self, y: Array) -> Array:
        """The value at ``y``."""
        return self.location + self.scale * jnp.sinh(jnp.arcsinh(y) + self.skew)

    def log_slope(self, y: Array) -> Array:
        """Log of dz/dy."""
        return jnp.log(self.scale) + jnp.log(jnp.cosh(jnp.arcsinh(y) + self.skew)) - jnp.log1p(y**2) / 2

    def log_change(self, y: Array) -> Array:
        """Log of dz/dy times the standard normal density of z over that of ``y``.

        What a model whose z is standard normal gains where y is sampled as if it were.
        """
        return self.log_slope(y) + (y**2 - self(y) ** 2) / 2
