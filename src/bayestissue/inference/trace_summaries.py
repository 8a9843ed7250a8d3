"""Each trace summarised once: where its likelihood lies and how sharply, for all impacts together."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.conditional import Summaries
from bayestissue.hierarchy.traces import TraceData, TraceModel, log_likelihood

ITERATIONS = 60
# Log likelihood that an expansion may promise above its value at the centre, along one axis; one that bends
# too little, or the wrong way, is given the bend that promises the least.
_MOST_GAIN, _LEAST_GAIN = 20.0, 1.0
_LEAST_BEND = 1e-9
# Of a log parameter of which a trace says nothing.
_LEAST_PRECISION = 1e-3
# Of a log parameter: far below where third derivatives count, far above rounding.
STEP = 1e-4


class Anchor(NamedTuple):
    """A normal prior of each impact's parameters: what the rest of the data say of them.

    Attributes:
        mean: [impact, parameter].
        precision: [impact, parameter, parameter].
    """

    mean: Float[Array, "impact parameter"]
    precision: Float[Array, "impact parameter parameter"]


def summarise_traces(
    model: TraceModel,
    data: TraceData,
    start: Float[Array, "impact parameter"],
    anchor: Anchor,
    iterations: int = ITERATIONS,
) -> Summaries:
    """Expand each log likelihood to second order where it, times the anchor, is greatest.

    Levenberg-Marquardt steps on every impact by itself. The gradient of the sum over impacts holds each
    impact's own, and its central differences their Hessians: exact enough, since a summary only whitens.

    Args:
        model: the model.
        data: the dataset.
        start: first guess.
        anchor: prior that keeps an impact whose trace says little where the others are.
        iterations: steps tried; with none the expansion is at ``start``.
    """
    # Given by place, so that what is compiled for one number of steps serves for any.
    return _summarise(model, data, start, anchor, iterations)


class _Expansion(NamedTuple):
    """A log likelihood to second order at ``u``, the curvature being minus its second derivatives."""

    u: Array
    value: Array
    slope: Array
    curvature: Array


@partial(jax.jit, static_argnames="model")
def _summarise(
    model: TraceModel, data: TraceData, start: Array, anchor: Anchor, iterations: int
) -> Summaries:
    size = start.shape[1]

    def likelihood(u: Array) -> Array:
        return log_likelihood(model, data, [u[:, a] for a in range(size)])

    def total(u: Array) -> tuple[Array, Array]:
        value = likelihood(u)
        return value.sum(), value

    slope_of = jax.grad(total, has_aux=True)

    def expansion(u: Array) -> _Expansion:
        steps = STEP * jnp.concatenate([jnp.zeros((1, size)), jnp.eye(size), -jnp.eye(size)])
        slopes, values = jax.lax.map(lambda step: slope_of(u + step), steps)
        columns = (slopes[1 : size + 1] - slopes[size + 1 :]) / (-2 * STEP)
        curvature = columns.transpose(1, 2, 0)
        return _Expansion(u, values[0], slopes[0], (curvature + curvature.swapaxes(1, 2)) / 2)

    def target(at: _Expansion) -> Array:
        away = at.u - anchor.mean
        return at.value - jnp.einsum("ia,iab,ib->i", away, anchor.precision, away) / 2

    def next_after(at: _Expansion, damping: Array) -> Array:
        slope = at.slope - jnp.einsum("iab,ib->ia", anchor.precision, at.u - anchor.mean)
        values, axes = jnp.linalg.eigh(at.curvature + anchor.precision)
        firm = jnp.abs(values) + damping[:, None] * jnp.abs(values).max(1, keepdims=True)
        move = jnp.einsum("iab,ib->ia", axes, jnp.einsum("iba,ib->ia", axes, slope) / firm)
        # No step may be longer than a unit of a log parameter.
        return at.u + move * jnp.minimum(1, 1 / jnp.abs(move).max(1, keepdims=True))

    # The likelihood stands here once, since most of a first fit is spent on compiling it: the start is the
    # first candidate, which nothing beats.
    def step(_: int, state: tuple[_Expansion, Array, Array, Array]) -> tuple[_Expansion, Array, Array, Array]:
        best, most, damping, candidate = state
        tried = expansion(candidate)
        value = target(tried)
        better = value > most
        best = jax.tree.map(
            lambda new, old: jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old), tried, best
        )
        damping = jnp.where(better, damping / 10, jnp.minimum(jnp.maximum(damping, 1e-12) * 10, 1e6))
        damping = jnp.maximum(damping, 1e-14)
        return best, jnp.where(better, value, most), damping, next_after(best, damping)

    number = start.shape[0]
    nothing = _Expansion(start, jnp.zeros(number), jnp.zeros((number, size)), jnp.zeros((number, size, size)))
    begin = (nothing, jnp.full(number, -jnp.inf), jnp.full(number, 1e-3), jnp.asarray(start))
    (u, value, slope, curvature), *_ = jax.lax.fori_loop(0, iterations + 1, step, begin)
    values, axes = jnp.linalg.eigh(curvature)
    firm = believable_bend(values, jnp.einsum("iab,ia->ib", axes, slope))
    precision = jnp.einsum("iab,ib,icb->iac", axes, firm, axes)
    return Summaries(u, slope, precision, value)


def believable_bend(bend: Float[Array, "*axis"], slope: Float[Array, "*axis"]) -> Float[Array, "*axis"]:
    """Minus the second derivative along each axis of an expansion, such that it promises no wonders.

    A likelihood anchored away from its own maximum may bend the wrong way there. Its summary
    exp(slope s - bend s^2 / 2) must all the same stay bounded, or else the wider the spread between impacts,
    the better it would seem to explain such traces.

    Args:
        bend: as found, of any sign.
        slope: along the axis.
    """
    believed = (bend > 0) & (slope**2 < 2 * _MOST_GAIN * bend)
    return jnp.maximum(jnp.where(believed, bend, slope**2 / (2 * _LEAST_GAIN)), _LEAST_BEND)


def least_bend(slope: Float[Array, "*axis"]) -> Float[Array, "*axis"]:
    """The bend with which a summary of this slope still promises no wonders, next to nothing without one."""
    return jnp.maximum(slope**2 / (2 * _MOST_GAIN), _LEAST_PRECISION)


def loose_anchor(start: Float[np.ndarray, "impact parameter"], sd: float = 2.0) -> Anchor:
    """A weak anchor about the first guess."""
    number, size = start.shape
    return Anchor(jnp.asarray(start), jnp.broadcast_to(jnp.eye(size) / sd**2, (number, size, size)))
