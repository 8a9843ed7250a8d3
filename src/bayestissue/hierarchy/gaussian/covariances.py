"""Covariances of the hierarchy: of an impact's parameters about X b, and of the fixed and group effects b."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.likelihood import small


class SharedMassError(NamedTuple):
    """The error of a person's mass, which moves the person's log K and log C in every impact alike.

    Attributes:
        effect_on_K: elements of b that are a person's effects on log K.
        effect_on_C: those on log C.
        variance: of the error of log mass.
    """

    effect_on_K: Int[np.ndarray | Array, " person"]
    effect_on_C: Int[np.ndarray | Array, " person"]
    variance: Float[Array, ""] | float


class EffectsPrecision(NamedTuple):
    """Prior precision of b, with one element more that stands for none.

    Attributes:
        diagonal: of the matrix; 1 for the last.
        partner: of each element the one that it shares an error with, or -1.
        between: the entry of the matrix between the two.
    """

    diagonal: Float[Array, " location+1"]
    partner: Int[Array, " location+1"] | None
    between: Float[Array, " location+1"] | None

    def among(self, elements: Int[Array, " inner *level"]) -> Float[Array, "inner inner *level"]:
        """The entries among some elements of b, level by level."""
        size = len(elements)
        one = jnp.eye(size).reshape(size, size, *[1] * (elements.ndim - 1))
        entries = one * self.diagonal[elements][None]
        if self.partner is None or self.between is None:
            return entries
        paired = self.partner[elements][:, None] == elements[None]
        return entries + jnp.where(paired, self.between[elements][:, None], 0.0)


class Covariances(NamedTuple):
    """Covariance of an impact's parameters about X b, and the standard deviations of b's elements.

    Attributes:
        pair: of (log K, log C) at the recorded mass, as (KK, KC, CC).
        nuisance: standard deviation of each nuisance parameter between impacts.
        locations: prior standard deviation of each element of b, a shared error left out.
        shared: the error of mass that a person's two effects share, where the mass is a person's own; b's
            effects of people are then those at the recorded mass.
    """

    pair: tuple[Array, Array, Array]
    nuisance: tuple[Array, ...]
    locations: Float[Array, " location"]
    shared: SharedMassError | None = None

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

    def of_effects(self) -> EffectsPrecision:
        """The prior precision of b."""
        diagonal = jnp.append(self.locations**-2.0, 1.0)
        if self.shared is None:
            return EffectsPrecision(diagonal, None, None)
        on_K, on_C, variance = self.shared
        K, C, determinant = self._pairs()
        diagonal = diagonal.at[on_K].set((C + variance) / determinant)
        diagonal = diagonal.at[on_C].set((K + variance) / determinant)
        partner = jnp.full(len(diagonal), -1).at[on_K].set(on_C).at[on_C].set(on_K)
        elements = jnp.concatenate([on_K, on_C])
        between = jnp.zeros_like(diagonal).at[elements].set(jnp.tile(-variance / determinant, 2))
        return EffectsPrecision(diagonal, partner, between)

    def log_scale(self) -> Float[Array, ""]:
        """Half the log determinant of b's prior covariance."""
        alone = jnp.log(self.locations).sum()
        if self.shared is None:
            return alone
        K, C, determinant = self._pairs()
        return alone + jnp.log(determinant / (K * C)).sum() / 2

    def _pairs(self) -> tuple[Array, Array, Array]:
        """Of each person: the variances of the two effects, and the covariance's determinant."""
        assert self.shared is not None  # noqa: S101 - the callers ask
        K, C = self.locations[self.shared.effect_on_K] ** 2, self.locations[self.shared.effect_on_C] ** 2
        return K, C, K * C + self.shared.variance * (K + C)
