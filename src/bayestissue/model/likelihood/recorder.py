"""A known low-pass between sensor and file: what it makes of an impact.

Its answer to an impulse is Re sum_k c_k e^(p_k t) for t >= 0, or Re sum_k c_k e^(p_k |t|) run forwards and
backwards. What it makes of a deceleration d that begins at contact is therefore Re sum_k c_k z_k with
z_k' = p_k z_k + d, and backwards -z_k' = p_k z_k + d. Over each interval of a grid z_k is known from what it
was, but for the integral of e^(p_k s) d. That is taken exactly of the cubic through d and its slope at both
ends, whose error is (omega dt)^4 / 384 of d: contact's jump lies at an end, and the poles may be fast.

A digital filter, which software ran over the samples, is the same by the trapezoidal rule: so says the
bilinear transform, s = (2 / T) (z - 1) / (z + 1), with p_k and c_k multiplied by
tan(omega_c T / 2) / (omega_c T / 2) so that the corner omega_c stays where it is. It knows d at the samples
alone, so that nothing happens between two of them, and its derivative in time is what it makes of d'.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Complex, Float

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerSample

# Of Gauss and Legendre's rule, exact to rounding for poles of many intervals.
_NODES = 16
# Between contact and the first sample, which may be some intervals later.
PIECES = 8
# Samples between contact and the first one that a digital filter remembers.
EARLIER = 64


class LowPass(NamedTuple):
    """A recorder's filter as `bayestissue.recordings.signal.filters.modes` has it.

    Attributes:
        pole: p_k [rad/s].
        weight: c_k [1/s].
        phase: moments of contact within a sampling interval that are told apart, as fractions of it, where
            the recording has to tell when contact was.
        ahead: run forwards and backwards, for how many sampling intervals before contact the answer counts
            is the length of this; None for a filter that can't look ahead.
        corner: of a digital filter, omega_c [rad/s]; None of an analog one.
    """

    pole: Complex[Array, " mode"]
    weight: Complex[Array, " mode"]
    phase: Float[Array, " phase"]
    ahead: Float[Array, " ahead"] | None = None
    corner: Float[Array, ""] | None = None

    @property
    def lead(self) -> int:
        """Sampling intervals before contact for which there is an answer."""
        return 0 if self.ahead is None else self.ahead.shape[0]


class Colour(NamedTuple):
    """Noise that went through the filter, by sampling rate: see `noise`. White noise has no entries.

    Attributes:
        first: L^-1 of the first p samples that are asked, T = L L'.
        predictor: what a later one less its prediction from the p before it is in units of its standard
            deviation: weights of itself and of those before it.
        spectrum: root of the eigenvalues of the noise's circulant covariance, all samples being asked.
        stride_marks: how many samples lie from one that is asked to the next is the length of this.
    """

    first: Float[Array, "rate first first"]
    predictor: Float[Array, "rate lag"]
    spectrum: Float[Array, "rate frequency"]
    stride_marks: Float[Array, " stride"]

    @classmethod
    def white_noise(cls) -> Colour:
        """All of it white."""
        return cls(jnp.zeros((1, 0, 0)), jnp.zeros((1, 0)), jnp.zeros((1, 0)), jnp.zeros(1))

    @property
    def is_white(self) -> bool:
        """Whether nothing went through a filter."""
        return not self.predictor.shape[1]

    @property
    def stride(self) -> int:
        """How many samples lie from one that is asked to the next."""
        return self.stride_marks.shape[0]


class Flow(NamedTuple):
    """A deceleration on an even grid and its slope.

    Attributes:
        d: deceleration [m/s^2].
        jerk: its derivative in time [m/s^3].
        dt: of the grid [s].
    """

    d: JaxPerSample
    jerk: JaxPerSample
    dt: JaxPerImpact

    def while_pushing(self) -> Flow:
        """The same, 0 once the force has fallen to 0."""
        pushes = jnp.cumprod(self.d[:, 1:] > 0, axis=1) > 0
        pushes = jnp.concatenate([jnp.ones_like(pushes[:, :1]), pushes], axis=1)
        return self._replace(d=jnp.where(pushes, self.d, 0.0), jerk=jnp.where(pushes, self.jerk, 0.0))

    def backwards(self) -> Flow:
        """Time running the other way."""
        return self._replace(d=self.d[:, ::-1], jerk=-self.jerk[:, ::-1])


def low_passed(
    low_pass: LowPass, early: Flow, later: Flow, since: Float[Array, "impact ahead"] | None = None
) -> tuple[Array, Array]:
    """What the filter makes of an impact, and its derivative in time, each [impact, sample].

    Args:
        low_pass: the filter.
        early: the impact from contact to the first sample after it, which is its last.
        later: the impact from that sample on, as long as the answer asked for and, where the filter looks
            ahead, as much longer as it does.
        since: times before contact at which there is an answer too, if there are any, negative [s].
    """
    weight, pole = low_pass.weight[:, None, None], low_pass.pole[:, None, None]
    still = jnp.zeros((len(low_pass.pole), len(later.dt)), complex)
    state = _passed(low_pass, later, _passed(low_pass, early, still)[..., -1])
    y, slope = weight * state, weight * (pole * state + later.d)
    if low_pass.ahead is None:
        return y.sum(0).real, slope.sum(0).real
    back = _passed(low_pass, later.backwards(), still)[..., ::-1]
    y, slope = y + weight * back, slope - weight * (pole * back + later.d)
    y, slope = y.sum(0).real, slope.sum(0).real
    if since is None:
        return y, slope
    whole = _passed(low_pass, early.backwards(), back[..., 0])[..., -1:]
    before = weight * whole * jnp.exp(-pole * since)
    before_slope = -pole * before
    pairs = ((before, y), (before_slope, slope))
    first, second = (jnp.concatenate([part.sum(0).real, later_part], axis=1) for part, later_part in pairs)
    return first, second


def _passed(low_pass: LowPass, flow: Flow, start: Complex[Array, "mode impact"]) -> Array:
    """z_k on the grid, [mode, impact, sample], from what it is at the first."""
    step = low_pass.pole[:, None] * flow.dt
    change = flow.dt[:, None] * flow.jerk
    parts = (flow.d[:, :-1], flow.d[:, 1:], change[:, :-1], change[:, 1:])
    integrals = _integrals(step)
    added = flow.dt[:, None] * sum(
        integral[..., None] * part for integral, part in zip(integrals, parts, strict=True)
    )
    return _accumulated(jnp.exp(step), jnp.concatenate([start[..., None], added], axis=-1))


def _accumulated(
    growth: Complex[Array, "*batch"], added: Complex[Array, "*batch sample"]
) -> Complex[Array, "*batch sample"]:
    """s_n = growth s_(n-1) + added_n; each round doubles how far back is added up."""
    state, reach = added, 1
    while reach < state.shape[-1]:
        state = state.at[..., reach:].add(growth[..., None] * state[..., :-reach])
        growth, reach = growth**2, 2 * reach
    return state


def samples_passed(
    low_pass: LowPass, corner: Float[Array, ""], flow: Flow, ahead: int
) -> tuple[Array, Array]:
    """What a digital filter makes of an impact, and its derivative in time, each [impact, sample].

    Args:
        low_pass: the filter.
        corner: omega_c [rad/s].
        flow: the impact from the first sample after contact on.
        ahead: how many samples before that one there is an answer at, too.
    """
    half = jnp.tan(corner * flow.dt / 2) / corner
    q = low_pass.pole[:, None, None] * half
    weight = (low_pass.weight[:, None, None] * half / (1 - q))[..., None]
    growth = jnp.broadcast_to((1 + q) / (1 - q), (len(q), 2, len(half)))

    def run(values: Array) -> Array:
        two = values + jnp.pad(values[..., :-1], ((0, 0), (0, 0), (1, 0)))
        return (weight * _accumulated(growth, two + jnp.zeros_like(growth)[..., None])).sum(0).real

    values = jnp.pad(jnp.stack([flow.d, flow.jerk]), ((0, 0), (0, 0), (ahead, 0)))
    passed = run(values)
    if low_pass.ahead is not None:
        passed = passed + run(values[..., ::-1])[..., ::-1]
    return passed[0], passed[1]


def _integrals(step: Complex[Array, "mode impact"]) -> tuple[Array, Array, Array, Array]:
    """Of e^(q (1 - s)) times the cubic that is 1 in a value or slope at 0 or 1 and 0 in the others."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    s, weights = (nodes + 1) / 2, weights / 2
    cubics = ((1 + 2 * s) * (1 - s) ** 2, s**2 * (3 - 2 * s), s * (1 - s) ** 2, -(s**2) * (1 - s))
    growth = jnp.exp(step[..., None] * (1 - s))
    value, value_end, slope, slope_end = ((growth * (weights * cubic)).sum(-1) for cubic in cubics)
    return value, value_end, slope, slope_end
