"""ARMA(2,1) coefficients of many impacts at once, by the thesis's conditional least squares (section 2.3).

The shocks are run forward as a_t = w_t + theta1 a_{t-1} from a_2 = 0, with

    w_t = x''_t + c1 x'_{t-1} + c2 x_{t-2},   c1 = 2 - phi1,   c2 = 1 - phi1 - phi2,

and their sum of squares is least. Given theta1 it is quadratic in c1 and c2, so these are solved for and one
dimension is left to search: on a grid, since the sum may have several minima, and on ever finer ones around
the best point. theta1 = tanh(eta) is finest towards -1 and 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

GRID = 17
ROUNDS = 7
# A variance below this share of the terms it is the remainder of is their rounding error.
ROUNDING = (64 * 2.2e-16) ** 2


class Moments(NamedTuple):
    """Sums of products of the shocks of three columns, for one theta1 of each impact.

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
        form: sum of squares at the optimum.
        floor: the sum of squares that rounding alone would leave.
    """

    c1: Float[Array, " impact"]
    c2: Float[Array, " impact"]
    theta1: Float[Array, " impact"]
    form: Float[Array, " impact"]
    floor: Float[Array, " impact"]


class Columns(NamedTuple):
    """What w_t is linear in, 0 past the end of an impact.

    Attributes:
        w: x''_t, to which c1 and c2 times the others are added.
        slope: x'_{t-1}.
        x: x_{t-2}.
    """

    w: Float[Array, "sample impact"]
    slope: Float[Array, "sample impact"]
    x: Float[Array, "sample impact"]

    def with_step(self, c1: Array, c2: Array) -> Columns:
        """The same with c1 and c2 so much greater."""
        return self._replace(w=self.w + c1 * self.slope + c2 * self.x)


def fit_conditional(
    x: Float[Array, "impact sample"], size: Float[Array, " impact"], fall: Float[Array, " impact"]
) -> Profile:
    """The least sum of squares over theta1 in [-1, 1], c1 and c2.

    Args:
        x: deviations from whatever is taken for the equilibrium.
        size: number of shocks of each impact, two less than there are samples.
        fall: what a constant force adds to every x''_t.
    """
    inside = (jnp.arange(x.shape[1] - 2) < size[:, None]).T
    slope = jnp.diff(x, axis=1)
    series = jnp.diff(slope, axis=1) - fall[:, None], slope[:, :-1], x[:, :-2]
    columns = Columns(*(jnp.where(inside, part.T, 0.0) for part in series))
    start = _start(columns, inside)
    left = columns.with_step(start.c1, start.c2)

    def loss(theta1: Array) -> Array:
        return size * jnp.log(_least(_moments(left, theta1, inside), start.floor)) / 2

    theta1 = _search(loss, size)
    best = _moments(left, theta1, inside)
    c1, c2 = _solve(best)
    return Profile(start.c1 + c1, start.c2 + c2, theta1, _least(best, start.floor), start.floor)


def _start(columns: Columns, inside: Bool[Array, "sample impact"]) -> Profile:
    """Least squares for theta1 = 0 in two steps: what the first leaves may be less than its rounding."""
    zero = jnp.zeros_like(columns.x[0])

    def refine(step: int, now: Profile) -> Profile:
        moments = _moments(columns.with_step(now.c1, now.c2), zero, inside)
        c1, c2 = _solve(moments)
        terms = moments.m00 + c1**2 * moments.m11 + c2**2 * moments.m22
        floor = jnp.where(step == 0, ROUNDING * terms + jnp.finfo(zero.dtype).tiny, now.floor)
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


def _moments(columns: Columns, theta1: Array, inside: Bool[Array, "sample impact"]) -> Moments:
    def step(carry: tuple[Array, Moments], part: tuple[Array, ...]) -> tuple[tuple[Array, Moments], None]:
        shocks, totals = carry
        *values, now = part
        shocks = jnp.where(now, jnp.stack(values) + theta1 * shocks, 0.0)
        a0, a1, a2 = shocks
        terms = Moments(a0 * a0, a0 * a1, a0 * a2, a1 * a1, a1 * a2, a2 * a2)
        return (shocks, Moments(*(t + term for t, term in zip(totals, terms, strict=True)))), None

    zero = jnp.zeros_like(theta1)
    start = (jnp.zeros((3, len(theta1)), theta1.dtype), Moments(*(zero,) * 6))
    (_, totals), _ = jax.lax.scan(step, start, (*columns, inside))
    return totals
