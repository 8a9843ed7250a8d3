"""Between the continuous A(2) and the ARMA(2,1) of its samples (thesis, section 2.11).

A well sampled impact has phi1 near 2 and phi2 near -1, where all information sits in the last digits.
The work is therefore done in c1 = 2 - phi1 and c2 = 1 - phi1 - phi2, which are of the order of
omega_n dt and (omega_n dt)^2, and which are never got by subtraction.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bayestissue.mechanics.oscillator.entire import arc_chord, chord, damped_pair, roots_above, sinc_root

# Gauss-Legendre on (0, 1): 40 nodes integrate exp(-2 a u) sin^2(b u) to rounding for a, b <= 12.
_NODES, _WEIGHTS = (half / 2 for half in np.polynomial.legendre.leggauss(40))
_NODES = _NODES + 0.5
_REACH = 12.0
_BRANCHES = 8


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
    return Differences(c1, c2, _theta_from_ratio(_ratio(w, zeta)))


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


def _theta_from_ratio(r: Array) -> Array:
    """The invertible root of -theta / (1 + theta^2) = r, the lag-one autocorrelation of an MA(1)."""
    tiny = jnp.finfo(r.dtype).tiny
    return -2 * r / (1 + jnp.sqrt(jnp.maximum((1 - 2 * r) * (1 + 2 * r), tiny)))


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
