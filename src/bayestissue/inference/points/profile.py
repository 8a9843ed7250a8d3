"""ARMA(2,1) coefficients of many impacts at once: by the exact likelihood, or the thesis's least squares.

Given theta1 the residual is linear in c1 = 2 - phi1 and c2 = 1 - phi1 - phi2, so these are solved for
and one dimension is left to search: on a grid, since the likelihood of a moving average may have several
maxima, and on ever finer ones around the best point. theta1 = tanh(eta) is finest towards -1 and 1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.likelihood.quadratic import eigenvalues, log_determinant, sums_over_frequencies
from bayestissue.likelihood.transforms import SineTransforms

GRID = 17
ROUNDS = 7
# A variance below this share of the terms it is the remainder of is their rounding error.
ROUNDING = (64 * 2.2e-16) ** 2


class Moments(NamedTuple):
    """Sums of products of the three columns, weighted by the inverse covariance for one theta1.

    Attributes:
        m00, m01, m02, m11, m12, m22: of the columns residual (0), x'_{t-1} (1) and x_{t-2} (2).
    """

    m00: Array
    m01: Array
    m02: Array
    m11: Array
    m12: Array
    m22: Array


class Profile(NamedTuple):
    """The fit with everything but theta1 at its best.

    Attributes:
        c1, c2: coefficients.
        theta1: moving-average coefficient.
        form: weighted sum of squares at the optimum.
        floor: the sum of squares that rounding alone would leave.
    """

    c1: Float[Array, " impact"]
    c2: Float[Array, " impact"]
    theta1: Float[Array, " impact"]
    form: Float[Array, " impact"]
    floor: Float[Array, " impact"]


Columns = tuple[Array, Array, Array]
Summation = Callable[[Columns, Array], Moments]


def profile_fit(
    columns: Columns,
    size: Float[Array, " impact"],
    summation: Summation,
    log_scale: Callable[[Array], Array],
    residual: Callable[[Columns, Array, Array], Array],
) -> Profile:
    """Maximise over theta1 in [-1, 1] the likelihood with c1, c2 and sigma_a at their best.

    Args:
        columns: x''_t, x'_{t-1} and x_{t-2}, in the form that ``summation`` takes.
        size: number of residuals of each impact.
        summation: moments of three columns for a theta1 of each impact.
        log_scale: log determinant of the covariance for a theta1 of each impact.
        residual: first column plus c1 times the second plus c2 times the third.
    """
    start = _start(columns, size, summation, residual)
    left = (residual(columns, start.c1, start.c2), *columns[1:])

    def loss(theta1: Array) -> Array:
        form = _least(summation(left, theta1), start.floor)
        return (size * jnp.log(form) + log_scale(theta1)) / 2

    theta1 = _search(loss, size)
    best = summation(left, theta1)
    step = _solve(best)
    return Profile(start.c1 + step[0], start.c2 + step[1], theta1, _least(best, start.floor), start.floor)


def _start(
    columns: Columns, size: Array, summation: Summation, residual: Callable[[Columns, Array, Array], Array]
) -> Profile:
    """Least squares for theta1 = 0 in two steps: what the first leaves may be less than its rounding."""
    zero = jnp.zeros_like(size)

    def refine(step: int, now: Profile) -> Profile:
        moments = summation((residual(columns, now.c1, now.c2), *columns[1:]), zero)
        c1, c2 = _solve(moments)
        terms = moments.m00 + c1**2 * moments.m11 + c2**2 * moments.m22
        floor = jnp.where(step == 0, ROUNDING * terms + jnp.finfo(size.dtype).tiny, now.floor)
        return Profile(now.c1 + c1, now.c2 + c2, zero, zero, floor)

    return jax.lax.fori_loop(0, 2, refine, Profile(*(zero,) * 5))


def _solve(m: Moments) -> tuple[Array, Array]:
    determinant = m.m11 * m.m22 - m.m12**2
    return (m.m12 * m.m02 - m.m22 * m.m01) / determinant, (m.m12 * m.m01 - m.m11 * m.m02) / determinant


def _least(m: Moments, floor: Array) -> Array:
    c1, c2 = _solve(m)
    return jnp.maximum(m.m00 + c1 * m.m01 + c2 * m.m02, 0.0) + floor


def _search(loss: Callable[[Array], Array], size: Array) -> Array:
    # tanh(reach) is nearer to the edge than the distance, 1/N, that N values can tell
    reach = jnp.log(20 * size) / 2

    def narrow(_: int, state: tuple[Array, Array]) -> tuple[Array, Array]:
        centre, width = state
        etas = jnp.clip(centre + width * jnp.linspace(-1, 1, GRID)[:, None], -reach, reach)
        best = jnp.argmin(jax.lax.map(lambda eta: loss(_theta(eta, reach)), etas), axis=0)
        return etas[best, jnp.arange(len(size))], 2 * width / (GRID - 1)

    centre, _ = jax.lax.fori_loop(0, ROUNDS, narrow, (jnp.zeros_like(size), reach))
    return _theta(centre, reach)


def _theta(eta: Array, reach: Array) -> Array:
    """tanh, stretched so that the ends of the search are -1 and 1 themselves."""
    return jnp.tanh(eta) / jnp.tanh(reach)


def fit_exact(data: SineTransforms) -> Profile:
    """The maximum of the exact likelihood with a free start."""
    return profile_fit(
        (data.columns[0], data.columns[1], data.columns[2]),
        data.size,
        partial(_exact_moments, spread=data.spread),
        lambda theta1: log_determinant(theta1, data.size),
        lambda c, c1, c2: c[0] + c1[:, None] * c[1] + c2[:, None] * c[2],
    )


def _exact_moments(columns: Columns, theta1: Array, *, spread: Array) -> Moments:
    y0, y1, y2 = columns
    over = 1 / eigenvalues(theta1[:, None], spread)
    z0, z1 = y0 * over, y1 * over
    return Moments(*sums_over_frequencies((y0 * z0, y1 * z0, y2 * z0, y1 * z1, y2 * z1, y2 * y2 * over)))


def fit_conditional(data: SineTransforms) -> Profile:
    """The thesis's conditional least squares (section 2.3).

    The shocks are run forward as a_t = w_t + theta1 a_{t-1} from a_2 = 0, and their sum of squares is least.

    ``data.x`` holds deviations from whatever is taken for the equilibrium; its transforms are not used.
    """
    x = data.x
    counts = (jnp.arange(x.shape[1] - 2) < data.size[:, None]).T
    slope = jnp.diff(x, axis=1)
    columns = tuple(
        jnp.where(counts, series.T, 0.0) for series in (jnp.diff(slope, axis=1), slope[:, :-1], x[:, :-2])
    )
    return profile_fit(
        columns,  # type: ignore[arg-type]
        data.size,
        partial(_conditional_moments, counts=counts),
        jnp.zeros_like,
        lambda c, c1, c2: c[0] + c1 * c[1] + c2 * c[2],
    )


def _conditional_moments(columns: Columns, theta1: Array, *, counts: Array) -> Moments:
    def step(carry: tuple[Array, Moments], part: tuple[Array, ...]) -> tuple[tuple[Array, Moments], None]:
        shocks, totals = carry
        *values, now = part
        shocks = jnp.where(now, jnp.stack(values) + theta1 * shocks, 0.0)
        a0, a1, a2 = shocks
        terms = Moments(a0 * a0, a0 * a1, a0 * a2, a1 * a1, a1 * a2, a2 * a2)
        return (shocks, Moments(*(t + term for t, term in zip(totals, terms, strict=True)))), None

    zero = jnp.zeros_like(theta1)
    start = (jnp.zeros((3, len(theta1)), theta1.dtype), Moments(*(zero,) * 6))
    (_, totals), _ = jax.lax.scan(step, start, (*columns, counts))
    return totals
