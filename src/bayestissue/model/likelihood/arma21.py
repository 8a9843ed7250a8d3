"""The exact log likelihood of an ARMA(2,1): no filter, no matrix (thesis, section 2.4, eq. 4)."""

from __future__ import annotations

from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from bayestissue.model.likelihood.moving_average import (
    eigenvalues,
    log_determinant,
    sine_transform,
    spread_of,
)
from bayestissue.model.likelihood.small import LOG_2PI

Start = Literal["free", "stationary"]


@partial(jax.jit, static_argnames="start")
def arma21_log_likelihood(
    x: ArrayLike,
    phi1: ArrayLike,
    phi2: ArrayLike,
    theta1: ArrayLike,
    sigma_a: ArrayLike,
    start: Start = "free",
) -> Array:
    """The exact log likelihood of x_t = phi1 x_{t-1} + phi2 x_{t-2} + a_t - theta1 a_{t-1} (eq. 4).

    Free start: -(N log(2 pi sigma_a^2) + log det T + W' L^-1 W / sigma_a^2) / 2, N = n - 2, with
    W = DST(x''_t + c1 x'_{t-1} + c2 x_{t-2}), c1 = 2 - phi1, c2 = 1 - phi1 - phi2, and T and its eigenvalues
    L as of `bayestissue.model.likelihood.moving_average`.

    Args:
        x: one series of at least three samples on the last axis [m]; leading axes broadcast with the
            parameters.
        phi1: first autoregressive coefficient.
        phi2: second autoregressive coefficient.
        theta1: moving-average coefficient, any real number.
        sigma_a: standard deviation of the shocks a_t [m].
        start: "free" gives the density of x_3 ... x_n given x_1 and x_2, the shock a_2 being as unknown
            as any other; "stationary" that of the whole series, -inf where no stationary distribution
            exists.

    Returns:
        The log density, differentiable by all arguments.

    Raises:
        ValueError: ``x`` is shorter than three samples, or ``start`` is neither word.
    """
    x = jnp.asarray(x, float)
    if x.ndim == 0 or x.shape[-1] < 3:
        raise ValueError("x needs at least three samples on its last axis")
    if start not in ("free", "stationary"):
        raise ValueError(f'start is "free" or "stationary", not {start!r}')
    phi1, phi2, theta1, sigma_a = (jnp.asarray(p, float) for p in (phi1, phi2, theta1, sigma_a))
    count, c1, c2 = x.shape[-1] - 2, 2 - phi1, (1 - phi1) - phi2
    slope = jnp.diff(x, axis=-1)
    w = jnp.diff(slope, axis=-1) + c1[..., None] * slope[..., :-1] + c2[..., None] * x[..., :-2]
    transformed = sine_transform(w)
    spread = jnp.asarray(spread_of(count), x.dtype)
    over = transformed / eigenvalues(theta1[..., None], spread)
    size = jnp.asarray(float(count))
    scale = size * (LOG_2PI + 2 * jnp.log(sigma_a)) + log_determinant(theta1, size)
    free = -(scale + (transformed * over).sum(-1) / sigma_a**2) / 2
    if start == "free":
        return free
    first = jnp.sqrt(spread * (4 - spread) / (2 * (count + 1)))
    end = (first * over).sum(-1)
    return free + _stationary(x[..., 0], x[..., 1], end, (c1, c2, theta1, sigma_a), size)


def arma21_series(
    first: Float[Array, "*batch 2"],
    shocks: Float[Array, " later *batch"],
    c1: Array,
    c2: Array,
    theta1: Array,
) -> Float[Array, "*batch sample"]:
    """The ARMA(2,1) that shocks drive from its first two values on.

    Args:
        first: x_1 and x_2 [m].
        shocks: a_2 ... a_n [m].
        c1: 2 - phi1.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient.
    """
    x1, x2 = (jnp.broadcast_to(first[..., i], shocks.shape[1:]) for i in (0, 1))

    def step(carry: tuple[Array, Array, Array], shock: Array) -> tuple[tuple[Array, Array, Array], Array]:
        before, now, last_shock = carry
        slope = now - before
        after = now + slope - c1 * slope - c2 * before + shock - theta1 * last_shock
        return (now, after, shock), after

    _, later = jax.lax.scan(step, (x1, x2, shocks[0]), shocks[1:])
    return jnp.moveaxis(jnp.concatenate([x1[None], x2[None], later]), 0, -1)


def start_moments(c1: Array, c2: Array, theta1: Array, sigma_a: Array) -> tuple[Array, Array]:
    """gamma_0 and gamma_0 - gamma_1 of a stationary ARMA(2,1), the difference without cancellation.

    Args:
        c1: 2 - phi1.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient.
        sigma_a: standard deviation of the shocks.
    """
    one_minus_phi2 = 2 - (c1 - c2)
    # this is (1 - phi2)(1 + theta1^2) - 2 theta1 phi1
    top = one_minus_phi2 * (1 - theta1) ** 2 + 2 * theta1 * c2
    flat = sigma_a**2 * top / ((c1 - c2) * (4 - 2 * c1 + c2))
    return flat / c2, (flat + theta1 * sigma_a**2) / one_minus_phi2


def _stationary(x1: Array, x2: Array, end: Array, parameters: tuple[Array, ...], count: Array) -> Array:
    """Log density of x_1 and x_2 given w: of all w only w_3 shares a shock, a_2, with them.

    Written for x_1 and x_2 - x_1, whose covariance keeps its digits when sampling is fine.

    Args:
        x1: first displacement.
        x2: second displacement.
        end: first element of T^-1 w.
        parameters: c1, c2, theta1, sigma_a.
        count: N.
    """
    c1, c2, theta1, sigma_a = parameters
    gamma0, drop = start_moments(c1, c2, theta1, sigma_a)
    corner = jnp.exp(log_determinant(theta1, count - 1) - log_determinant(theta1, count))
    step_variance = 2 * drop - theta1**2 * sigma_a**2 * corner
    determinant = gamma0 * step_variance - drop**2
    stationary = (c2 > 0) & (c1 > c2) & (4 - 2 * c1 + c2 > 0) & (determinant > 0)
    safe = jnp.where(stationary, determinant, 1.0)
    step = x2 - x1 + theta1 * end
    form = (step_variance * x1**2 + 2 * drop * x1 * step + gamma0 * step**2) / safe
    return jnp.where(stationary, -(2 * LOG_2PI + jnp.log(safe) + form) / 2, -jnp.inf)
