"""Spring and damper side by side: F = K x + C x' (thesis, section 2.12)."""

from __future__ import annotations

from jax import Array

from bayestissue.elements.element import Element, Parameter, Parameters, States


def force(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x + C v [N]."""
    return p["K"] * x + p["C"] * v


def stored(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x^2 / 2 [J]."""
    return p["K"] * x**2 / 2


ELEMENT = Element(
    name="kelvin_voigt",
    title="spring and damper side by side (Kelvin-Voigt)",
    parameters=(
        Parameter("K", "N/m", "stiffness of the spring"),
        Parameter("C", "N s/m", "damping beside it"),
    ),
    force=force,
    stored=stored,
    linear=True,
)
