"""Functions of the squared frequency that have no seam at critical damping.

With q = omega_n^2 (1 - zeta^2) t^2, positive below critical damping and negative above it, cos(sqrt q)
and sin(sqrt q)/sqrt q are entire: cosh and sinh above are the same functions as cos and sin below. Each
function here switches between a power series and a closed form where both are exact to rounding, so that
values and all derivatives pass through q = 0 unharmed.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, factorial

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

_SINE_SERIES = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(11))
_ARC_SERIES = tuple(2.0 / (k * k * comb(2 * k, k)) for k in range(1, 16))


def sinc_root(q: ArrayLike) -> Array:
    """sin(sqrt q) / sqrt q, which is sinh(sqrt(-q)) / sqrt(-q) for negative q; any shape."""
    q = jnp.asarray(q, float)
    small = jnp.abs(q) < 1.0
    root = jnp.sqrt(jnp.where(small, 1.0, jnp.abs(q)))
    # sinh of a root that belongs to a positive q could overflow and poison the gradient
    above = jnp.sinh(jnp.where(q < 0, root, 1.0)) / root
    away_from_zero = jnp.where(q < 0, above, jnp.sin(root) / root)
    return jnp.where(small, horner(_SINE_SERIES, jnp.where(small, q, 0.0)), away_from_zero)


def chord(q: ArrayLike) -> Array:
    """4 sin^2(sqrt(q) / 2) = 2 - 2 cos(sqrt q), exact to rounding near q = 0; any shape."""
    q = jnp.asarray(q, float)
    return q * sinc_root(q / 4) ** 2


def arc_chord(h: ArrayLike) -> Array:
    """The inverse of `chord` on its main branch: q <= pi^2 with 4 sin^2(sqrt(q)/2) = h.

    Any shape; NaN for h > 4, which no real q gives.
    """
    h = jnp.asarray(h, float)
    small = jnp.abs(h) < 0.25
    positive = jnp.where(small | (h < 0), 1.0, h)
    below = (2 * jnp.arctan2(jnp.sqrt(positive), jnp.sqrt(4.0 - positive))) ** 2
    above = -((2 * jnp.arcsinh(jnp.sqrt(jnp.where(small | (h > 0), 1.0, -h)) / 2)) ** 2)
    series = jnp.where(small, h, 0.0)
    return jnp.where(small, series * horner(_ARC_SERIES, series), jnp.where(h < 0, above, below))


def damped_pair(angle: ArrayLike, zeta: ArrayLike) -> tuple[Array, Array]:
    """exp(-zeta w) cos(sqrt q) and exp(-zeta w) sin(sqrt q)/sqrt q with q = w^2 (1 - zeta^2).

    The two solutions of the free A(2) after the angle w = omega_n t >= 0; neither overflows, however
    strong the damping.

    Args:
        angle: omega_n t, non-negative [rad].
        zeta: damping ratio; broadcasts with ``angle``.
    """
    w, zeta = jnp.asarray(angle, float), jnp.asarray(zeta, float)
    q = w**2 * (1 - zeta) * (1 + zeta)
    strong = q < -1.0
    slow, fast, beta = roots_above(jnp.where(strong, w, 2.0), jnp.where(strong, zeta, 2.0))
    mild_q, decay = jnp.where(strong, 0.0, q), jnp.exp(-jnp.where(strong, 0.0, zeta * w))
    cosine = jnp.where(strong, (jnp.exp(slow) + jnp.exp(fast)) / 2, decay * (1.0 - chord(mild_q) / 2))
    sine = jnp.where(strong, (jnp.exp(slow) - jnp.exp(fast)) / (2 * beta), decay * sinc_root(mild_q))
    return cosine, sine


def roots_above(angle: Array, zeta: Array) -> tuple[Array, Array, Array]:
    """mu_1 t, mu_2 t and half their distance for zeta > 1 (eq. 19), the slow root without cancellation."""
    beta = angle * jnp.sqrt((zeta - 1) * (zeta + 1))
    fast = -(zeta * angle + beta)
    return angle**2 / fast, fast, beta


def horner(coefficients: Sequence[float | Array], x: Array) -> Array:
    """The polynomial with these coefficients, that of 1 first."""
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * x + coefficient
    return total
