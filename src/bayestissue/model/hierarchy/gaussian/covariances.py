"""Covariances of the hierarchy: of an impact's parameters about X b, and of the fixed and group effects b."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from bayestissue.model.likelihood import small


class Covariances(NamedTuple):
    """Covariance of an impact's parameters about X b, and the standard deviations of b's elements.

    Attributes:
        pair: of (log K, log C) at the recorded mass, as (KK, KC, CC).
        nuisance: standard deviation of each nuisance parameter between impacts.
        locations: prior standard deviation of each element of b.
    """

    pair: tuple[Array, Array, Array]
    nuisance: tuple[Array, ...]
    locations: Float[Array, " location"]

    @property
    def pair_matrix(self) -> Float[Array, "2 2 *batch"]:
        """That of (log K, log C) as a matrix."""
        kk, kc, cc = self.pair
        return small.stacked([[kk, kc], [kc, cc]])

    def of_impact(self) -> Float[Array, "parameter parameter *batch"]:
        """D, the precision of an impact's parameters about X b."""
        kk, kc, cc = self.pair
        determinant = kk * cc - kc**2
        size = 2 + len(self.nuisance)
        rows = [[jnp.zeros_like(kk)] * size for _ in range(size)]
        rows[0][0], rows[1][1] = cc / determinant, kk / determinant
        rows[0][1] = rows[1][0] = -kc / determinant
        for a, sd in enumerate(self.nuisance, start=2):
            rows[a][a] = sd**-2.0
        return jnp.stack([jnp.stack(row) for row in rows])

    def precision_among(self, elements: Int[Array, " inner *level"]) -> Float[Array, "inner inner *level"]:
        """Prior precision of b among some of its elements, level by level; one past the last: of none, 1."""
        size = len(elements)
        one = jnp.eye(size).reshape(size, size, *[1] * (elements.ndim - 1))
        return one * jnp.append(self.locations**-2.0, 1.0)[elements][None]

    def log_scale(self) -> Float[Array, ""]:
        """Half the log determinant of b's prior covariance."""
        return jnp.log(self.locations).sum()
