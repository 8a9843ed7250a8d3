"""Tissue of thickness h on a rigid backing, beside a damper: F = K x / (1 - x / h) + C x'.

The force grows without bound as the tissue is pressed flat. Beyond 95 % of the thickness it goes on as a
parabola in 1 / (1 - x / h)'s place, with the same value, slope and curvature: a solver's trial step behind
the wall must meet a great force, not one of the wrong sign.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from bayestissue.mechanics.elements.element import Element, Parameter, Parameters, States

_LAST = 0.95
_ROOM = 1 - _LAST


def force(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x / (1 - x / h) + C v [N]."""
    strain = x / p["thickness_m"]
    near = strain < _LAST
    open_ = 1 / (1 - jnp.where(near, strain, 0.0))
    past = (jnp.where(near, _LAST, strain) - _LAST) / _ROOM
    return p["K"] * x * jnp.where(near, open_, (1 + past + past**2) / _ROOM) + p["C"] * v


def stored(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K h^2 (-log(1 - x / h) - x / h) [J], and its continuation beyond 95 % of the thickness."""
    strain = x / p["thickness_m"]
    near = strain < _LAST
    inner = jnp.where(near, strain, _LAST)
    past = (jnp.where(near, _LAST, strain) - _LAST) / _ROOM
    # The integral of strain (1 + past + past^2) / _ROOM from _LAST on.
    beyond = _LAST * (past + past**2 / 2 + past**3 / 3) + _ROOM * (past**2 / 2 + past**3 / 3 + past**4 / 4)
    return p["K"] * p["thickness_m"] ** 2 * (-jnp.log1p(-inner) - inner + beyond)


ELEMENT = Element(
    name="wall",
    title="tissue of finite thickness on a rigid backing, beside a damper",
    law="F = K x / (1 - x / h) + C x'",
    K="tangent stiffness at contact",
    C="damping",
    force=force,
    stored=stored,
    extra=(Parameter("thickness_m", "m", "thickness of the tissue, pressed flat by no finite force", 0.03),),
)
