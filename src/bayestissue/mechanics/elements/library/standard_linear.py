"""A spring beside a Maxwell arm: the standard linear solid, F = K x + r K (x - s), s' = r K (x - s) / C."""

from __future__ import annotations

from jax import Array

from bayestissue.mechanics.elements.element import Element, Parameter, Parameters, States

_RATIO = Parameter("arm_ratio", "1", "stiffness of the arm's spring over K; infinite is Kelvin-Voigt", 2.0)


def _arm(x: Array, s: States, p: Parameters) -> Array:
    return p[_RATIO.name] * p["K"] * (x - s[0])


def force(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x and the arm's r K (x - s) [N], s being how far the arm's damper has yielded [m]."""
    return p["K"] * x + _arm(x, s, p)


def rates(x: Array, v: Array, s: States, p: Parameters) -> States:
    """S' = r K (x - s) / C [m/s]."""
    return (_arm(x, s, p) / p["C"],)


def stored(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x^2 / 2 + r K (x - s)^2 / 2 [J]."""
    return (p["K"] * x**2 + _arm(x, s, p) * (x - s[0])) / 2


ELEMENT = Element(
    name="standard_linear",
    title="spring beside a spring and damper in series (standard linear solid)",
    law=r"F = K x + r K (x - s), \; s' = r K (x - s) / C",
    K="stiffness of the lone spring, which is that at rest; (1 + arm_ratio) K at contact",
    C="damping in the arm",
    force=force,
    stored=stored,
    extra=(_RATIO,),
    jumps=False,
    rates=rates,
    states=1,
    linear=True,
)
