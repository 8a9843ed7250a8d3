"""A mass of tissue between impactor and Kelvin-Voigt: (M + m) x'' = -(K x + C x'), x'(0) = V M / (M + m).

The impactor takes the tissue at its surface along at once, without restitution: its velocity jumps, and from
then on both move as one. An accelerometer on the impactor reads F / (M + m). The recording of one mass M
shows m in its height over V alone, and K that is read from it as that of M is too small: K M / (M + m).
"""

from __future__ import annotations

from jax import Array

from bayestissue.mechanics.elements.element import Element, Parameter, Parameters
from bayestissue.mechanics.elements.library.kelvin_voigt import force, stored

_MASS = Parameter(
    "moving_mass_kg", "kg", "mass of the tissue that moves along with the impactor", 0.1, log_sd=1.5
)


def added_mass(p: Parameters) -> Array:
    """The tissue's m [kg]."""
    return p[_MASS.name]


def guess(K: Array, C: Array, mass: Array) -> tuple[Array, Array]:
    """K and C of the same motion of M and a typical m: (M + m) / M times larger."""
    heavier = 1 + _MASS.typical / mass
    return K * heavier, C * heavier


ELEMENT = Element(
    name="moving_mass",
    title="mass of tissue that moves along, on a spring beside a damper",
    law=r"F = K x + C x', \; (M + m) x'' = -F, \; x'(0) = V M / (M + m)",
    K="stiffness of the spring",
    C="damping beside it",
    force=force,
    stored=stored,
    extra=(_MASS,),
    linear=True,
    added_mass=added_mass,
    guess=guess,
)
