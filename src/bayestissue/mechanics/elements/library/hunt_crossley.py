"""A ball on an elastic half-space with losses: F = k x^(3/2) + c x^(3/2) x' (Hertz; Hunt and Crossley 1975).

k = 4/3 E* sqrt(R). To be comparable with other elements, k and c are written through the stiffness and
damping at a depth of 10 mm under a ball of the reference diameter D0 = 31.8 mm:
k = K sqrt(D / D0) / sqrt(10 mm), so that E* = 3/4 K / sqrt(D0 / 2 * 10 mm), and
c = C sqrt(D / D0) / (10 mm)^(3/2).
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from bayestissue.mechanics.elements.element import (
    REFERENCE_DIAMETER_M,
    Element,
    Parameters,
    States,
)

REFERENCE_DEPTH_M = 0.01


def _depth(x: Array, p: Parameters) -> tuple[Array, Array]:
    """sqrt(D / D0) (x / 10 mm)^(3/2), 0 out of contact, and x itself where it is positive."""
    inside = x > 0
    depth = jnp.where(inside, x, REFERENCE_DEPTH_M) / REFERENCE_DEPTH_M
    size = jnp.sqrt(p["diameter_m"] / REFERENCE_DIAMETER_M)
    return jnp.where(inside, size * depth * jnp.sqrt(depth), 0.0), jnp.maximum(x, 0.0)


def force(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x^(3/2) + c x^(3/2) v [N]; 0 out of contact."""
    return _depth(x, p)[0] * (p["K"] * REFERENCE_DEPTH_M + p["C"] * v)


def stored(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """2/5 k x^(5/2) [J]."""
    shape, depth = _depth(x, p)
    return 0.4 * p["K"] * REFERENCE_DEPTH_M * shape * depth


ELEMENT = Element(
    name="hunt_crossley",
    title="ball on an elastic half-space with losses (Hertz, Hunt-Crossley)",
    law=r"F = k x^{3/2} + c\, x^{3/2} x'",
    K="secant stiffness at a depth of 10 mm under a ball of 31.8 mm",
    C="damping there",
    force=force,
    stored=stored,
    jumps=False,
)
