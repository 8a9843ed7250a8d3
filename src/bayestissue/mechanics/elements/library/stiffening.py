"""A spring that stiffens with depth, beside a damper: F = K x (1 + (x / x_s)^2) + C x', Duffing's spring."""

from __future__ import annotations

from jax import Array

from bayestissue.mechanics.elements.element import Element, Parameter, Parameters, States


def force(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x (1 + (x / x_s)^2) + C v [N]."""
    return p["K"] * x * (1 + (x / p["stiffening_depth_m"]) ** 2) + p["C"] * v


def stored(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x^2 / 2 (1 + (x / x_s)^2 / 2) [J]."""
    return p["K"] * x**2 / 2 * (1 + (x / p["stiffening_depth_m"]) ** 2 / 2)


ELEMENT = Element(
    name="stiffening",
    title="stiffening spring beside a damper",
    law=r"F = K x \left(1 + (x / x_s)^2\right) + C x'",
    K="tangent stiffness at contact",
    C="damping",
    force=force,
    stored=stored,
    extra=(Parameter("stiffening_depth_m", "m", "depth at which the secant stiffness has doubled", 0.02),),
)
