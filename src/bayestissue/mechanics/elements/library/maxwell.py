"""Spring and damper in series: the spring pushes with K (x - s), and the damper yields by s' = F / C."""

from __future__ import annotations

from jax import Array

from bayestissue.mechanics.elements.element import Element, Parameters, States


def force(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K (x - s) [N], s being how far the damper has yielded [m]."""
    return p["K"] * (x - s[0])


def rates(x: Array, v: Array, s: States, p: Parameters) -> States:
    """S' = K (x - s) / C [m/s]."""
    return (p["K"] / p["C"] * (x - s[0]),)


def stored(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K (x - s)^2 / 2 [J]."""
    return p["K"] * (x - s[0]) ** 2 / 2


def guess(K: Array, C: Array, mass: Array) -> tuple[Array, Array]:
    """K, and the damping with which the force lags as much at the natural frequency: K M / C."""
    return K, K * mass / C


ELEMENT = Element(
    name="maxwell",
    title="spring and damper in series (Maxwell)",
    law=r"F = K (x - s), \; s' = F / C",
    K="stiffness of the spring: the tangent stiffness at contact",
    C="damping behind it",
    force=force,
    stored=stored,
    jumps=False,
    rates=rates,
    states=1,
    linear=True,
    guess=guess,
)
