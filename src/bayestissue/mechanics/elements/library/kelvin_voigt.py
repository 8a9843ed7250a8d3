"""Spring and damper side by side: F = K x + C x' (thesis, section 2.12)."""

from __future__ import annotations

from jax import Array

from bayestissue.mechanics.elements.element import Element, Outcomes, Parameters, States
from bayestissue.mechanics.oscillator import (
    contact_duration,
    peak_deceleration,
    peak_displacement,
    peak_jerk,
    restitution,
    spring_damper_inverse,
    time_to_peak,
)


def force(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x + C v [N]."""
    return p["K"] * x + p["C"] * v


def stored(x: Array, v: Array, s: States, p: Parameters) -> Array:
    """K x^2 / 2 [J]."""
    return p["K"] * x**2 / 2


def level_outcomes(p: Parameters, mass: Array, velocity: Array) -> Outcomes:
    """From the closed forms of `bayestissue.mechanics.oscillator`."""
    K, C, V = p["K"], p["C"], velocity
    omega_n, zeta = spring_damper_inverse(K, C, mass)
    rebounds = restitution(zeta)
    lost = 1 - rebounds**2
    return {
        "K_tangent": K,
        "K_secant": K,
        "C_equivalent": C,
        "energy_lost": lost,
        "energy_share": lost,
        "energy_share_with_gravity": lost,
        "peak_depth": peak_displacement(omega_n, zeta, V),
        "time_to_peak": time_to_peak(omega_n, zeta),
        "peak_force": mass * peak_deceleration(omega_n, zeta, V),
        "contact_duration": contact_duration(omega_n, zeta),
        "rebound_velocity": rebounds * V,
        "impulse": mass * V * (1 + rebounds),
        "peak_jerk": peak_jerk(omega_n, zeta, V),
    }


ELEMENT = Element(
    name="kelvin_voigt",
    title="spring and damper side by side (Kelvin-Voigt)",
    law="F = K x + C x'",
    K="stiffness of the spring",
    C="damping beside it",
    force=force,
    stored=stored,
    linear=True,
    level_outcomes=level_outcomes,
)
