"""Green's functions and autocovariances of the ARMA(2,1) and of the A(2) (thesis, sections 2.5 to 2.10)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from bayestissue.oscillator.discrete import from_differences
from bayestissue.oscillator.entire import damped_pair


@jax.jit
def green_a2(time: ArrayLike, omega_n: ArrayLike, zeta: ArrayLike) -> Array:
    """G(t) = (e^(mu_1 t) - e^(mu_2 t)) / (mu_1 - mu_2), the A(2)'s answer to a unit impulse (eq. 20).

    Written e^(-zeta omega_n t) sin(omega_d t) / omega_d, which passes through critical damping.
    Arguments broadcast.

    Args:
        time: time since the impulse [s]; G is 0 before it.
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.

    Returns:
        G [s].
    """
    time = jnp.maximum(jnp.asarray(time, float), 0.0)
    return time * damped_pair(omega_n * time, zeta)[1]


@jax.jit
def autocovariance_a2(lag: ArrayLike, omega_n: ArrayLike, zeta: ArrayLike, sigma_z: ArrayLike = 1.0) -> Array:
    """gamma(s) = gamma(0) e^(-zeta omega_n s) (cos omega_d s + zeta omega_n sin(omega_d s) / omega_d).

    gamma(0) = sigma_z^2 / (4 zeta omega_n^3).
    The thesis's gamma(s) of section 2.10 with e^(mu s) where it prints e^(mu t), and without the minus
    sign it prints before gamma(0). Arguments broadcast.

    Args:
        lag: s [s], of either sign.
        omega_n: natural frequency [rad/s].
        zeta: damping ratio, positive: an undamped A(2) has no stationary distribution.
        sigma_z: strength of the white forcing Z(t), E[Z(t) Z(t-u)] = sigma_z^2 delta(u).
    """
    omega_n, zeta, sigma_z = (jnp.asarray(p, float) for p in (omega_n, zeta, sigma_z))
    angle = omega_n * jnp.abs(jnp.asarray(lag, float))
    cosine, sine = damped_pair(angle, zeta)
    return sigma_z**2 / (4 * zeta * omega_n**3) * (cosine + zeta * angle * sine)


def green_arma21_implicit(phi1: ArrayLike, phi2: ArrayLike, theta1: ArrayLike, count: int) -> Array:
    """G_0 = 1, G_1 = phi1 - theta1, G_j = phi1 G_{j-1} + phi2 G_{j-2}: the implicit method (eq. 8).

    Any real coefficients; they broadcast.

    Returns:
        G_0 ... G_{count-1} on a last axis.
    """
    phi1, phi2, theta1 = jnp.broadcast_arrays(*(jnp.asarray(c, float) for c in (phi1, phi2, theta1)))

    def step(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        now, after = carry
        return (after, phi1 * after + phi2 * now), now

    _, values = jax.lax.scan(step, (jnp.ones_like(phi1), phi1 - theta1), length=count)
    return jnp.moveaxis(values, 0, -1)


@jax.jit
def green_arma21(j: ArrayLike, phi1: ArrayLike, phi2: ArrayLike, theta1: ArrayLike) -> Array:
    """G_j = g_1 lambda_1^j + g_2 lambda_2^j, the explicit method (eq. 9), also at equal roots.

    Written G_j = U_j - theta1 U_{j-1} with U_j = (lambda_1^(j+1) - lambda_2^(j+1)) / (lambda_1 - lambda_2),
    which is the Green's function of an A(2) at (j + 1) dt over its value at dt. Arguments broadcast.

    Args:
        j: lag, a non-negative integer.
        phi1: first autoregressive coefficient.
        phi2: second autoregressive coefficient, negative, and with phi1 such that the roots are complex
            or positive, as those of every sampled A(2) are; NaN otherwise.
        theta1: moving-average coefficient.
    """
    j = jnp.asarray(j)
    w, zeta = _main_branch(phi1, phi2)
    return _unit(j, w, zeta) - theta1 * _unit(j - 1, w, zeta)


@jax.jit
def autocovariance_arma21(
    lag: ArrayLike, phi1: ArrayLike, phi2: ArrayLike, theta1: ArrayLike, sigma_a: ArrayLike = 1.0
) -> Array:
    """gamma_k = d_1 lambda_1^k + d_2 lambda_2^k (eqs 11 and 12), also at equal roots.

    Written gamma_k = gamma_1 U_{k-1} + phi2 gamma_0 U_{k-2} with U as in `green_arma21` and with
    gamma_0 (1 + phi2)(1 - phi1 - phi2)(1 + phi1 - phi2)
    = sigma_a^2 [(1 - phi2)(1 + theta1^2) - 2 theta1 phi1]. Arguments broadcast.

    Args:
        lag: k, an integer of either sign.
        phi1: first autoregressive coefficient, of a stationary process.
        phi2: second autoregressive coefficient, as in `green_arma21`.
        theta1: moving-average coefficient.
        sigma_a: standard deviation of the shocks, in the unit of x.
    """
    k = jnp.abs(jnp.asarray(lag))
    phi1, phi2 = jnp.asarray(phi1, float), jnp.asarray(phi2, float)
    gamma0, drop = start_moments(2 - phi1, (1 - phi1) - phi2, theta1, sigma_a)
    w, zeta = _main_branch(phi1, phi2)
    later = (gamma0 - drop) * _unit(k - 1, w, zeta) + phi2 * gamma0 * _unit(k - 2, w, zeta)
    return jnp.where(k == 0, gamma0, later)


def start_moments(c1: ArrayLike, c2: ArrayLike, theta1: ArrayLike, sigma_a: ArrayLike) -> tuple[Array, Array]:
    """gamma_0 and gamma_0 - gamma_1 of a stationary ARMA(2,1), the difference without cancellation.

    Args:
        c1: 2 - phi1.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient.
        sigma_a: standard deviation of the shocks.
    """
    c1, c2, theta1, sigma_a = (jnp.asarray(p, float) for p in (c1, c2, theta1, sigma_a))
    one_minus_phi2 = 2 - (c1 - c2)
    # this is (1 - phi2)(1 + theta1^2) - 2 theta1 phi1
    top = one_minus_phi2 * (1 - theta1) ** 2 + 2 * theta1 * c2
    flat = sigma_a**2 * top / ((c1 - c2) * (4 - 2 * c1 + c2))
    return flat / c2, (flat + theta1 * sigma_a**2) / one_minus_phi2


def _main_branch(phi1: ArrayLike, phi2: ArrayLike) -> tuple[Array, Array]:
    """omega_n dt and zeta of the A(2) whose roots these are; any value of arccos has the same powers."""
    phi1, phi2 = jnp.asarray(phi1, float), jnp.asarray(phi2, float)
    return from_differences(2 - phi1, (1 - phi1) - phi2, None, 1.0)


def _unit(j: Array, w: Array, zeta: Array) -> Array:
    return jnp.where(j < 0, 0.0, green_a2(j + 1, w, zeta) / green_a2(1, w, zeta))
