"""An impact on a spring and a damper side by side (thesis, section 2.12), in closed form."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from bayestissue.oscillator.entire import arc_chord, damped_pair, sinc_root


class Motion(NamedTuple):
    """The impactor's path after contact.

    Attributes:
        displacement: into the tissue [m].
        velocity: into the tissue [m/s].
        deceleration: positive while the impactor slows [m/s^2].
    """

    displacement: Array
    velocity: Array
    deceleration: Array


def spring_damper(omega_n: ArrayLike, zeta: ArrayLike, mass: ArrayLike) -> tuple[Array, Array]:
    """K = M omega_n^2 and C = 2 zeta omega_n M (thesis, section 2.12). Arguments broadcast.

    Args:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        mass: impacting mass M [kg].

    Returns:
        K [N/m] and C [N s/m].
    """
    omega_n, zeta, mass = (jnp.asarray(p, float) for p in (omega_n, zeta, mass))
    return mass * omega_n**2, 2 * zeta * omega_n * mass


def spring_damper_inverse(K: ArrayLike, C: ArrayLike, mass: ArrayLike) -> tuple[Array, Array]:
    """omega_n = sqrt(K / M) [rad/s] and zeta = C / (2 sqrt(K M)): the inverse of `spring_damper`."""
    K, mass = jnp.asarray(K, float), jnp.asarray(mass, float)
    return jnp.sqrt(K / mass), jnp.asarray(C, float) / (2 * jnp.sqrt(K * mass))


def impact_motion(time: ArrayLike, omega_n: ArrayLike, zeta: ArrayLike, velocity: ArrayLike) -> Motion:
    """x(t) = V e^(-zeta omega_n t) sin(omega_d t) / omega_d and its derivatives, from contact on.

    The deceleration is 2 zeta omega_n v + omega_n^2 x: it jumps to 2 zeta omega_n V = C V / M at contact.
    Arguments broadcast; smooth through critical damping.

    Args:
        time: time since contact [s], not negative.
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        velocity: impactor's velocity V at contact [m/s].
    """
    time, omega_n, zeta, velocity = (jnp.asarray(p, float) for p in (time, omega_n, zeta, velocity))
    cosine, sine = damped_pair(omega_n * time, zeta)
    x = velocity * time * sine
    v = velocity * cosine - zeta * omega_n * x
    return Motion(x, v, 2 * zeta * omega_n * v + omega_n**2 * x)


def time_to_peak(omega_n: ArrayLike, zeta: ArrayLike) -> Array:
    """Time from contact to zero velocity, arccos(zeta) / (omega_n sqrt(1 - zeta^2)) [s].

    At zeta = 1 this is 1 / omega_n and above it arccosh(zeta) / (omega_n sqrt(zeta^2 - 1)): one smooth
    function. Arguments broadcast: omega_n [rad/s], zeta > -1.
    """
    omega_n, zeta = jnp.asarray(omega_n, float), jnp.asarray(zeta, float)
    return 1 / (omega_n * sinc_root(arc_chord(2 * (1 - zeta))))


def peak_displacement(omega_n: ArrayLike, zeta: ArrayLike, velocity: ArrayLike) -> Array:
    """Greatest displacement, (V / omega_n) exp(-zeta omega_n t_peak) [m].

    Arguments broadcast: omega_n [rad/s], zeta > -1, velocity V at contact [m/s].
    """
    omega_n, zeta, velocity = (jnp.asarray(p, float) for p in (omega_n, zeta, velocity))
    return velocity / omega_n * jnp.exp(-zeta * omega_n * time_to_peak(omega_n, zeta))
