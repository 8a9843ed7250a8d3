"""An impact on a spring and a damper side by side (thesis, section 2.12), in closed form."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from bayestissue.mechanics.oscillator.entire import arc_chord, damped_pair, sinc_root


class ContactPath(NamedTuple):
    """The impactor's path after contact.

    Attributes:
        displacement: into the tissue [m].
        velocity: into the tissue [m/s].
        deceleration: force over mass F / M = g - x'', what a sensor reads that is 0 in free fall [m/s^2].
            Without gravity along the motion it is -x'', positive while the impactor slows.
    """

    displacement: Array
    velocity: Array
    deceleration: Array


@jax.jit
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


@jax.jit
def spring_damper_inverse(K: ArrayLike, C: ArrayLike, mass: ArrayLike) -> tuple[Array, Array]:
    """omega_n = sqrt(K / M) [rad/s] and zeta = C / (2 sqrt(K M)): the inverse of `spring_damper`."""
    K, mass = jnp.asarray(K, float), jnp.asarray(mass, float)
    return jnp.sqrt(K / mass), jnp.asarray(C, float) / (2 * jnp.sqrt(K * mass))


@jax.jit
def impact_motion(
    time: ArrayLike, omega_n: ArrayLike, zeta: ArrayLike, velocity: ArrayLike, gravity: ArrayLike = 0.0
) -> ContactPath:
    """The motion x'' = g - 2 zeta omega_n x' - omega_n^2 x from x = 0 and x' = V at contact on.

    With u(t) = e^(-zeta omega_n t) sin(omega_d t) / omega_d, the answer to a unit impulse, and the depth
    x_e = g / omega_n^2 at which the impactor comes to rest,

        x = V u + x_e (1 - u' - 2 zeta omega_n u),   x' = V u' + g u.

    The deceleration F / M = 2 zeta omega_n x' + omega_n^2 x jumps to 2 zeta omega_n V = C V / M at contact.
    Arguments broadcast; smooth through critical damping.

    Args:
        time: time since contact [s], not negative.
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        velocity: impactor's velocity V at contact [m/s].
        gravity: g, the part of gravity along the motion [m/s^2], positive into the tissue.
    """
    time, omega_n, zeta, velocity, gravity = _floats(time, omega_n, zeta, velocity, gravity)
    cosine, sine = damped_pair(omega_n * time, zeta)
    u = time * sine
    slope = cosine - zeta * omega_n * u
    x = velocity * u + gravity / omega_n**2 * (1 - slope - 2 * zeta * omega_n * u)
    v = velocity * slope + gravity * u
    return ContactPath(x, v, 2 * zeta * omega_n * v + omega_n**2 * x)


@jax.jit
def time_to_peak(
    omega_n: ArrayLike, zeta: ArrayLike, velocity: ArrayLike = 1.0, gravity: ArrayLike = 0.0
) -> Array:
    """Time from contact to zero velocity, arccos(zeta) / (omega_n sqrt(1 - zeta^2)) [s].

    At zeta = 1 this is 1 / omega_n and above it arccosh(zeta) / (omega_n sqrt(zeta^2 - 1)): one smooth
    function. With gravity along the motion the same of R omega_n and (zeta - s) / R, where
    s = g / (omega_n V) and R^2 = 1 - 2 zeta s + s^2; infinite where strong damping lets the impactor sink to
    its rest x_e = g / omega_n^2 from above, without a peak. Arguments broadcast.

    Args:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio, above -1.
        velocity: V at contact [m/s]; without gravity it does not matter.
        gravity: g, the part of gravity along the motion [m/s^2].
    """
    omega_n, zeta, velocity, gravity = _floats(omega_n, zeta, velocity, gravity)
    ratio, cosine, peaks = _turn(omega_n, zeta, velocity, gravity)
    return jnp.where(peaks, 1 / (omega_n * ratio * sinc_root(arc_chord(2 * (1 - cosine)))), jnp.inf)


@jax.jit
def peak_displacement(
    omega_n: ArrayLike, zeta: ArrayLike, velocity: ArrayLike, gravity: ArrayLike = 0.0
) -> Array:
    """Greatest displacement, x_e + R (V / omega_n) exp(-zeta omega_n t_peak) [m].

    Symbols and arguments as of `time_to_peak`; R = 1 and x_e = 0 without gravity. Where there is no peak it
    is x_e, at which the impactor comes to rest.
    """
    omega_n, zeta, velocity, gravity = _floats(omega_n, zeta, velocity, gravity)
    ratio, _, peaks = _turn(omega_n, zeta, velocity, gravity)
    time = time_to_peak(omega_n, zeta, velocity, gravity)
    decay = jnp.exp(-zeta * omega_n * jnp.where(peaks, time, 0.0))
    return gravity / omega_n**2 + jnp.where(peaks, ratio * velocity / omega_n * decay, 0.0)


@jax.jit
def contact_duration(omega_n: ArrayLike, zeta: ArrayLike) -> Array:
    """From contact to where the force is 0, twice the time to the peak [s] (thesis, section 2.12).

    With phi = arccos zeta the force over mass is omega_n V e^(-zeta omega_n t) sin(2 phi - omega_d t) / sin
    phi. Without gravity along the motion; arguments as of `time_to_peak`.
    """
    return 2 * time_to_peak(omega_n, zeta)


@jax.jit
def restitution(zeta: ArrayLike) -> Array:
    """The velocity at which the impactor leaves over that at contact, exp(-2 zeta phi / sin phi).

    phi = arccos zeta, and phi / sin phi is omega_n times the time to the peak, also past critical damping.
    Without gravity along the motion.
    """
    zeta = jnp.asarray(zeta, float)
    return jnp.exp(-2 * zeta * time_to_peak(1.0, zeta))


@jax.jit
def peak_deceleration(omega_n: ArrayLike, zeta: ArrayLike, velocity: ArrayLike) -> Array:
    """The greatest F / M [m/s^2]: omega_n V exp(-zeta (3 phi - pi) / sin phi), phi = arccos zeta.

    From zeta = 1/2 on it is at contact, where the damper pushes with 2 zeta omega_n V. Without gravity along
    the motion; arguments as of `time_to_peak`.
    """
    omega_n, zeta, velocity = _floats(omega_n, zeta, velocity)
    weak = jnp.minimum(zeta, 0.5)
    phi = jnp.arccos(weak)
    later = jnp.exp(-weak * (3 * phi - jnp.pi) / jnp.sin(phi))
    return omega_n * velocity * jnp.where(zeta < 0.5, later, 2 * zeta)


@jax.jit
def peak_jerk(omega_n: ArrayLike, zeta: ArrayLike, velocity: ArrayLike) -> Array:
    """The greatest |d/dt F / M| between contact and leaving [m/s^3], without the damper's jump at contact.

    With phi = arccos zeta the rate is -omega_n^2 V e^(-zeta omega_n t) sin(3 phi - omega_d t) / sin phi. Its
    size is omega_n^2 V |4 zeta^2 - 1| just after contact and, up to zeta = (1/2)^(1/2),
    omega_n^2 V exp(-zeta (4 phi - pi) / sin phi) where it is stationary: the greater of both. Without gravity
    along the motion; arguments as of `time_to_peak`.
    """
    omega_n, zeta, velocity = _floats(omega_n, zeta, velocity)
    weak = jnp.minimum(zeta, jnp.sqrt(0.5))
    phi = jnp.arccos(weak)
    later = jnp.exp(-weak * (4 * phi - jnp.pi) / jnp.sin(phi))
    return omega_n**2 * velocity * jnp.maximum(jnp.abs(4 * zeta**2 - 1), later)


def _turn(omega_n: Array, zeta: Array, velocity: Array, gravity: Array) -> tuple[Array, Array, Array]:
    """R, (zeta - s) / R and whether there is a peak: see `time_to_peak`."""
    fall = gravity / (omega_n * velocity)
    square = 1 - 2 * zeta * fall + fall**2
    # Below critical damping the square is above 0 anyway. No number has neither.
    peaks = ~((zeta >= 1) & ((zeta <= fall) | (square <= 0)))
    ratio = jnp.sqrt(jnp.where(peaks, square, 1.0))
    return ratio, jnp.where(peaks, (zeta - fall) / ratio, 0.0), peaks


def _floats(*values: ArrayLike) -> tuple[Array, ...]:
    return tuple(jnp.asarray(value, float) for value in values)
