"""The thesis's fit: conditional least squares about the sample mean (DDS, section 2.3).

The shocks are run forward as a_t = w_t + theta1 a_{t-1} from a_2 = 0, and their sum of squares is made
least.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from bayestissue.inference.points.profile import (
    Columns,
    Covariance,
    Moments,
    Profile,
    invert,
    profile_fit,
)
from bayestissue.likelihood.transforms import SineTransforms


def fit_conditional(data: SineTransforms) -> tuple[Profile, Covariance]:
    """Conditional least squares on ``data.x``, and the covariance by Gauss and Newton.

    ``data.x`` holds deviations from whatever is taken for the equilibrium; its transforms are not used.
    The shock variance in the covariance is taken over N - 3 degrees of freedom.
    """
    x = data.x
    counts = (jnp.arange(x.shape[1] - 2) < data.size[:, None]).T
    slope = jnp.diff(x, axis=1)
    columns = tuple(
        jnp.where(counts, series.T, 0.0) for series in (jnp.diff(slope, axis=1), slope[:, :-1], x[:, :-2])
    )
    fit = profile_fit(
        columns,  # type: ignore[arg-type]
        data.size,
        partial(_moments, counts=counts),
        jnp.zeros_like,
        lambda c, c1, c2: c[0] + c1 * c[1] + c2 * c[2],
    )
    return fit, _covariance(fit, columns, counts, data.size)


def _moments(columns: Columns, theta1: Array, *, counts: Array) -> Moments:
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


def _covariance(fit: Profile, columns: tuple[Array, ...], counts: Array, size: Array) -> Covariance:
    w = columns[0] + fit.c1 * columns[1] + fit.c2 * columns[2]

    def step(carry: tuple[Array, Array], part: tuple[Array, ...]) -> tuple[tuple[Array, Array], None]:
        state, totals = carry
        *values, now = part
        a, by_c1, by_c2, by_theta = state
        state = jnp.stack([*values, a]) + fit.theta1 * jnp.stack([a, by_c1, by_c2, by_theta])
        state = jnp.where(now, state, 0.0)
        return (state, totals + state[1:, None] * state[None, 1:]), None

    start = (jnp.zeros((4, len(size)), w.dtype), jnp.zeros((3, 3, len(size)), w.dtype))
    (_, totals), _ = jax.lax.scan(step, start, (w, columns[1], columns[2], counts))
    i = totals * (size - 3) / fit.form
    on_edge = jnp.abs(fit.theta1) > 1 - 1 / size
    return invert((i[0, 0], i[0, 1], i[1, 1]), (i[0, 2], i[1, 2]), i[2, 2], on_edge)
