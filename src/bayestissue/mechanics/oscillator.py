"""The physics: (K, C, M), (omega_n, zeta) and (phi1, phi2, theta1), and the ways between them.

An impact on a spring and a damper side by side (thesis, section 2.12) is there in closed form; and so is what
lies between the continuous A(2) and the ARMA(2,1) of its samples (section 2.11). A well sampled impact has
phi1 near 2 and phi2 near -1, where all information sits in the last digits. The work is therefore done in
c1 = 2 - phi1 and c2 = 1 - phi1 - phi2, which are of the order of omega_n dt and (omega_n dt)^2, and which are
never got by subtraction.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bayestissue.mechanics.entire import arc_chord, chord, damped_pair, roots_above, sinc_root

# Gauss-Legendre on (0, 1): 40 nodes integrate exp(-2 a u) sin^2(b u) to rounding for a, b <= 12.
_NODES, _WEIGHTS = (half / 2 for half in np.polynomial.legendre.leggauss(40))
_NODES = _NODES + 0.5
_REACH = 12.0
_BRANCHES = 8


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


class Differences(NamedTuple):
    """An ARMA(2,1) as x''_t + c1 x'_{t-1} + c2 x_{t-2} = a_t - theta1 a_{t-1}, with backward differences.

    Attributes:
        c1: 2 - phi1, about 2 zeta omega_n dt + (omega_n dt)^2.
        c2: 1 - phi1 - phi2, about (omega_n dt)^2.
        theta1: moving-average coefficient.
    """

    c1: Array
    c2: Array
    theta1: Array


@jax.jit
def to_discrete(omega_n: ArrayLike, zeta: ArrayLike, dt: ArrayLike) -> tuple[Array, Array, Array]:
    """phi1 = 2 e^(-zeta omega_n dt) cos(omega_d dt), phi2 = -e^(-2 zeta omega_n dt), and theta1.

    theta1 is the invertible moving-average coefficient that gives the samples the autocovariance of the
    A(2) (thesis, sections 2.6, 2.10 and 2.11; Pandit & Wu 1983). All arguments broadcast; smooth in value
    and derivatives through critical damping.

    Args:
        omega_n: natural frequency [rad/s], positive.
        zeta: damping ratio, not negative; above 1 is overdamped.
        dt: sampling interval [s].

    Returns:
        phi1, phi2 and theta1, without unit.
    """
    c1, _, theta1 = to_differences(omega_n, zeta, dt)
    decay = jnp.asarray(zeta, float) * omega_n * dt
    return 2.0 - c1, -jnp.exp(-2 * decay) + jnp.zeros_like(c1), theta1


@jax.jit
def to_differences(omega_n: ArrayLike, zeta: ArrayLike, dt: ArrayLike) -> Differences:
    """`to_discrete` in the well-conditioned c1 = 2 - phi1 and c2 = 1 - phi1 - phi2.

    c1 = -2 expm1(-a) + e^(-a) 4 sin^2(b/2), c2 = expm1(-a)^2 + e^(-a) 4 sin^2(b/2) with
    a = zeta omega_n dt and b = omega_d dt; well above critical damping c1 and c2 are the sum and the
    product of 1 - lambda_1 and 1 - lambda_2 instead. Arguments as in `to_discrete`.
    """
    w, zeta = jnp.broadcast_arrays(jnp.asarray(omega_n, float) * dt, jnp.asarray(zeta, float))
    strong = zeta > 1.5
    slow, fast, _ = roots_above(w, jnp.where(strong, zeta, 2.0))
    u1, u2 = -jnp.expm1(slow), -jnp.expm1(fast)
    mild = jnp.where(strong, 1.0, zeta)
    lost = jnp.expm1(-mild * w)
    bend = jnp.exp(-mild * w) * chord(w**2 * (1 - mild) * (1 + mild))
    c1 = jnp.where(strong, u1 + u2, bend - 2 * lost)
    c2 = jnp.where(strong, u1 * u2, lost**2 + bend)
    # The invertible root of -theta / (1 + theta^2) = r, the lag-one autocorrelation of an MA(1).
    r = _ratio(w, zeta)
    root = jnp.sqrt(jnp.maximum((1 - 2 * r) * (1 + 2 * r), jnp.finfo(r.dtype).tiny))
    return Differences(c1, c2, -2 * r / (1 + root))


@jax.jit
def to_continuous(phi1: ArrayLike, phi2: ArrayLike, theta1: ArrayLike, dt: ArrayLike) -> tuple[Array, Array]:
    """omega_n = sqrt(a^2 + b^2) / dt and zeta = a / sqrt(a^2 + b^2), a = -ln(-phi2)/2 (section 2.11).

    For complex roots b is one of the many values of arccos(phi1 / (2 sqrt(-phi2))); which one is told by
    theta1, as the thesis's expression in theta1 + 1/theta1 does: see `arccos_branch`. For real roots
    b^2 is negative, b^2 = -arccosh(...)^2. All arguments broadcast; differentiable, and smooth where
    complex roots turn real.

    Args:
        phi1: first autoregressive coefficient, with the thesis's signs (eq. 4).
        phi2: second autoregressive coefficient.
        theta1: moving-average coefficient.
        dt: sampling interval [s].

    Returns:
        omega_n [rad/s] and zeta; both NaN where no A(2) has these coefficients: phi2 >= 0 or negative
        real roots.
    """
    phi1, phi2 = jnp.asarray(phi1, float), jnp.asarray(phi2, float)
    return from_differences(2.0 - phi1, (1.0 - phi1) - phi2, theta1, dt)


@jax.jit
def from_differences(
    c1: ArrayLike, c2: ArrayLike, theta1: ArrayLike | None, dt: ArrayLike
) -> tuple[Array, Array]:
    """`to_continuous` from c1 = 2 - phi1 and c2 = 1 - phi1 - phi2.

    Without theta1 (None) the main value of arccos is taken. It is the right one whenever the oscillator
    turns by less than half a period from sample to sample.
    """
    c1, c2 = jnp.broadcast_arrays(jnp.asarray(c1, float), jnp.asarray(c2, float))
    a, q = _decay_and_bend(c1, c2)
    if theta1 is not None:
        c1, c2, a, q, theta1 = jnp.broadcast_arrays(c1, c2, a, q, jnp.asarray(theta1, float))
        branch = _branch(c1, c2, theta1, a, q)
        principal = jnp.sqrt(jnp.where(q > 0, q, 1.0))
        # branch 0 keeps q itself, whose derivatives pass smoothly through zero
        q = jnp.where(branch == 0, q, _candidate(principal, branch) ** 2)
    strong = q < -0.5 * a**2
    w = jnp.sqrt(jnp.where(strong, _product_of_roots(c1, c2, strong), a**2 + q))
    return w / dt, a / w


@jax.jit
def arccos_branch(phi1: ArrayLike, phi2: ArrayLike, theta1: ArrayLike) -> Array:
    """Which value of arccos the moving-average coefficient asks for: 0 is the main one, p in (0, pi).

    The values are p, 2 pi - p, 2 pi + p, 4 pi - p, ... numbered 0, 1, 2, 3, ... The autocovariance of
    the A(2) makes a sin(b)/b a known function u of (phi1, phi2, theta1), where a = -ln(-phi2)/2; solved
    for b this is the thesis's expression for b in theta1 + 1/theta1 (section 2.11), whose sign is that of
    sin(b) and carries no information on |b|. The value of arccos with |a sin(b)/b| nearest to |u| is
    taken, which agrees with the expression whenever theta1 is the coefficient of a sampled A(2), and
    does not run away when it is only near one. Real roots: 0.
    """
    phi1, phi2 = jnp.asarray(phi1, float), jnp.asarray(phi2, float)
    c1, c2, theta1 = jnp.broadcast_arrays(2.0 - phi1, (1.0 - phi1) - phi2, jnp.asarray(theta1, float))
    return _branch(c1, c2, theta1, *_decay_and_bend(c1, c2))


def _decay_and_bend(c1: Array, c2: Array) -> tuple[Array, Array]:
    a = -jnp.log1p(c2 - c1) / 2
    return a, arc_chord((c2 - jnp.expm1(-a) ** 2) * jnp.exp(a))


def _product_of_roots(c1: Array, c2: Array, strong: Array) -> Array:
    """mu_1 mu_2 dt^2 from 1 - lambda_1 and 1 - lambda_2, for the strongly overdamped."""
    c1, c2 = jnp.where(strong, c1, 1.0), jnp.where(strong, c2, 0.1)
    larger = (c1 + jnp.sqrt(jnp.maximum(c1**2 - 4 * c2, 0.0))) / 2
    return jnp.log1p(-larger) * jnp.log1p(-c2 / larger)


def _branch(c1: Array, c2: Array, theta1: Array, a: Array, q: Array) -> Array:
    phi1, one_minus_phi2 = 2.0 - c1, 2.0 - (c1 - c2)
    r = -theta1 / (1 + theta1**2)
    wanted = jnp.exp(a) * (c1 - c2) * (phi1 / 2 + r * one_minus_phi2) / (one_minus_phi2 + 2 * r * phi1)
    principal = jnp.sqrt(jnp.where(q > 0, q, 1.0))[..., None]
    numbers = jnp.arange(2 * _BRANCHES)
    candidates = _candidate(principal, numbers)
    offered = jnp.abs(a)[..., None] * jnp.sin(principal) / candidates
    nearest = jnp.argmin(jnp.abs(offered - jnp.abs(wanted)[..., None]), axis=-1)
    return jnp.where(q > 0, nearest, 0)


def _candidate(principal: Array, branch: Array) -> Array:
    turns = 2 * jnp.pi * ((branch + 1) // 2).astype(principal.dtype)
    return turns + jnp.where(branch % 2 == 0, 1, -1) * principal


def _ratio(w: Array, zeta: Array) -> Array:
    """Lag-one autocorrelation of x_t - phi1 x_{t-1} - phi2 x_{t-2} for a sampled A(2)."""
    a, q = zeta * w, w**2 * (1 - zeta) * (1 + zeta)
    near = (a < _REACH) & (jnp.abs(q) < _REACH**2)
    quadrature = _ratio_by_quadrature(jnp.where(near, a, 1.0), jnp.where(near, q, 1.0))
    return jnp.where(near, quadrature, _ratio_by_autocovariance(jnp.where(near, 20.0, w), zeta))


def _ratio_by_quadrature(a: Array, q: Array) -> Array:
    """Both moments as integrals of products of the Green's function over one sampling interval.

    The integrands are of one sign where sampling is fine: the differences of autocovariances that they
    replace lose (omega_n dt)^3 of their digits.
    """
    a, q = a[..., None], q[..., None]
    u = _NODES.astype(a.dtype)
    there, back = u * sinc_root(q * u**2), (1 - u) * sinc_root(q * (1 - u) ** 2)
    weight = _WEIGHTS.astype(a.dtype)
    lag0 = jnp.sum(weight * (jnp.exp(-2 * a * u) + jnp.exp(2 * a * u - 4 * a)) * there**2, axis=-1)
    lag1 = jnp.sum(weight * jnp.exp(-2 * a * u - a) * there * back, axis=-1)
    return lag1 / lag0


def _ratio_by_autocovariance(w: Array, zeta: Array) -> Array:
    cosine, sine = damped_pair(w, zeta)
    gamma1 = cosine + zeta * w * sine
    phi1, phi2 = 2 * cosine, -jnp.exp(-2 * zeta * w)
    lag1 = (1 - phi2) * gamma1 - phi1
    lag0 = 1 - phi2**2 - phi1 * (1 + phi2) * gamma1 - phi1 * lag1
    return lag1 / lag0
