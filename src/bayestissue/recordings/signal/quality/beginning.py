"""Whether a recording that begins above zero begins at contact, or after it, or with an offset.

A recording from t after contact on has the motion x(t) = x₁ + v₁ t − ∬(d − g), v(t) = v₁ − ∫(d − g), where
(x₁, v₁) is the state that (0, V) grows into under the tissue's own law until the first sample. Every law
below is linear in coefficients of which none is negative: the force over mass

    d = Σ c_j φ_j(x, v, ∫x, ∫d),  c_j ≥ 0,

is that of a damper beside a spring that stiffens, of a spring and damper in series, alone or beside a spring,
or of Hertz's contact with losses. Contact is tried at moments until one sampling interval before the first
sample, and at earlier ones; an offset at several sizes; between them the residuals are interpolated. Each
account has the law that explains the trace best by it. What earlier contact or an offset gains over contact
at the first sample is then an F test of one parameter.

The velocity at contact is known as well as the dataset says, and to 0.3 % at the best: its error looks much
like a late beginning.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.recordings.signal.displacement import Displacements
from bayestissue.recordings.signal.integrals import trapezoids
from bayestissue.recordings.signal.padded_traces import Column, Index, Mask, Rows
from bayestissue.recordings.signal.quality.samples import PulseAndRests, chance
from bayestissue.recordings.signal.signal_settings import BEGINNING

type State = Float[np.ndarray, "4 ..."]
type Terms = Float[np.ndarray, "*row term"]
type Law = Callable[[State], Terms]
type Moments = Float[np.ndarray, "account impact"]
type Residuals = Float[np.ndarray, "*account impact block"]


class _Blocks(NamedTuple):
    """Means over blocks of samples, [impact, block], in units of velocity and time to peak.

    From the first sample on: t, d, its integral (``lost``), and the parts of velocity, displacement and the
    integral of displacement that come of d and gravity; ``weight`` is 1 over the standard deviation of d, 0
    where there is no block; ``fall`` [impact, 1] is gravity. Of each impact are the greatest deceleration,
    the sampling interval, and the standard deviations of velocity and zero.
    """

    t: Rows
    d: Rows
    lost: Rows
    v: Rows
    x: Rows
    x_integral: Rows
    weight: Rows
    fall: Rows
    peak: Column
    interval: Column
    velocity_sd: Column
    zero_sd: Column


def _stiffening(y: State) -> Terms:
    x, v, *_ = y
    depth = np.maximum(x, 0)
    return np.stack([v, x, depth**2, depth**3, depth**8], axis=-1)


def _in_series(y: State) -> Terms:
    x, _, x_integral, lost = y
    return np.stack([x, x_integral, -lost], axis=-1)


def _hertz(y: State) -> Terms:
    x, v, *_ = y
    depth = np.maximum(x, 0) ** 1.5
    return np.stack([depth, depth * v], axis=-1)


_LAWS: tuple[Law, ...] = (_stiffening, _in_series, _hertz)


def beginning(
    recorded: PulseAndRests, signal: Displacements, chosen: Mask, uncertainty: Uncertainty
) -> tuple[Mask, Column]:
    """What the recordings say of their beginnings.

    Args:
        recorded: the recordings.
        signal: what is made of them, over the rebound.
        chosen: which are asked: those that begin above zero.
        uncertainty: of the velocity, of the recorder's gain, which is one of velocity to it, and of its zero.

    Returns:
        Whether contact came before the first sample, or there is an offset; and how long before the first
        sample contact may have come, where this can't be told from contact there, s, else 0.
    """
    missed, longest, rows = np.zeros_like(chosen), np.zeros(len(chosen)), np.flatnonzero(chosen)
    if not rows.size:
        return missed, longest
    blocks = _blocks(recorded, signal, rows, uncertainty)
    least = np.maximum(BEGINNING.intervals * blocks.interval, BEGINNING.share)
    most = np.maximum(BEGINNING.longest, 2 * least)
    early = least + (most - least) * np.linspace(0, 1, BEGINNING.moments)[:, None] ** 2
    offsets = np.multiply.outer(BEGINNING.offsets, blocks.peak)
    accounts = [_accounts(law, blocks, early, offsets) for law in _LAWS]
    contact, late, shifted, of_early = (np.min(squares, axis=0) for squares in zip(*accounts, strict=True))
    count = np.maximum((blocks.weight > 0).sum(axis=1) - BEGINNING.parameters, 1)
    freedom = recorded.freedom[rows]
    unexplained = np.zeros(rows.size, bool)
    for square in (late, shifted):
        gain = np.maximum(contact - square, 0) / np.maximum(square / count, 1)
        # Between the moments and offsets tried a trace of little noise is explained roughly.
        explains = chance(square, count, freedom) > BEGINNING.leaves
        explains |= square < contact / BEGINNING.better
        unexplained |= explains & (fdtrc(1, np.minimum(count, freedom), gain) < BEGINNING.gains)
    missed[rows] = unexplained
    possible = np.where(~unexplained & (of_early < contact + BEGINNING.likely), early, 0).max(axis=0)
    longest[rows] = possible * signal.time_to_peak[rows]
    return missed, longest


def _blocks(recorded: PulseAndRests, signal: Displacements, rows: Index, uncertainty: Uncertainty) -> _Blocks:
    """The blocks of some impacts."""
    d, dt, to_peak = signal.deceleration[rows], signal.dt[rows, None], signal.time_to_peak[rows, None]
    velocity, peak = signal.velocity[rows, None], recorded.peak[rows, None]
    sample = np.arange(d.shape[1])
    sample_number = signal.sample_numbers[rows]
    time, unit = sample_number * dt, velocity / to_peak
    over = np.cumsum((time > to_peak) & (d < BEGINNING.ends * peak), axis=1) > 0
    count = ((sample < signal.n_samples[rows, None]) & ~over).sum(axis=1)
    v, x = signal.v[rows], signal.x[rows]
    x = (x - x[:, :1] - v[:, :1] * time) / (velocity * to_peak)
    v, fall = (v - v[:, :1]) / velocity, signal.gravity[rows, None] / unit
    t = time / to_peak
    longest = -(-count // BEGINNING.blocks)[:, None]
    ends = np.minimum(np.arange(BEGINNING.blocks + 1) * longest, count[:, None])
    size = np.diff(ends, axis=1)

    def means(value: Rows) -> Rows:
        sums = np.cumsum(np.where(sample < count[:, None], value, 0), axis=1)
        sums = np.take_along_axis(np.pad(sums, ((0, 0), (1, 0))), ends, axis=1)
        return np.diff(sums, axis=1) / np.maximum(size, 1)

    sd = np.hypot(recorded.sd[rows, None] / np.sqrt(np.maximum(size, 1)), BEGINNING.misfit * peak) / unit
    columns = (t, d / unit, fall * t - v, v, x, trapezoids(x, np.diff(sample_number, axis=1) * dt / to_peak))
    t, d, lost, v, x, x_integral = (means(column) for column in columns)
    weight = np.where(size > 0, 1 / sd, 0)
    velocity_sd = np.hypot(uncertainty.of_velocity(signal.velocity[rows]), BEGINNING.velocity)
    sds = velocity_sd, uncertainty.offset_sd / unit[:, 0]
    of_impacts = recorded.peak[rows] / unit[:, 0], signal.dt[rows] / signal.time_to_peak[rows]
    return _Blocks(t, d, lost, v, x, x_integral, weight, fall, *of_impacts, *sds)


def _accounts(
    law: Law, blocks: _Blocks, early: Moments, offsets: Moments
) -> tuple[Column, Column, Column, Moments]:
    """Least sums of squares of one law's accounts: contact in the interval, earlier, an offset.

    The last are those of each of the earlier moments.
    """
    interval = blocks.interval
    middle, none = interval / 2 + 0 * early[:1], np.zeros((3, len(interval)))
    moments = np.concatenate([none + np.array([0, 0.5, 1])[:, None] * interval, early])
    since = np.concatenate([moments, 0 * offsets + middle, middle, middle])
    offset, faster = np.zeros_like(since), np.zeros_like(since)
    offset[len(moments) : -2], offset[-1], faster[-2] = offsets, BEGINNING.small, BEGINNING.small
    residuals = _residuals(law, blocks, since, offset, faster)
    # Errors of velocity and offset as they are declared; and, with an offset, contact in the interval.
    of_velocity = (residuals[-2] - residuals[1]) * (blocks.velocity_sd / BEGINNING.small)[:, None]
    of_offset = _less_error(
        (residuals[-1] - residuals[1]) * (blocks.zero_sd / BEGINNING.small)[:, None], of_velocity
    )
    of_contact = _less_error(_less_error(residuals[2] - residuals[0], of_velocity), of_offset)
    residuals = _less_error(_less_error(residuals[:-2], of_velocity), of_offset)
    shifted = _less_error(residuals[len(moments) :], of_contact)
    late = residuals[3 : len(moments)]
    half = len(offsets) // 2
    offset_least = np.minimum(_least(shifted[:half]), _least(shifted[half:]))
    return _least(residuals[:3]), _least(late), offset_least, (late**2).sum(axis=-1)


def _residuals(law: Law, blocks: _Blocks, since: Moments, offset: Moments, faster: Moments) -> Residuals:
    """What a law leaves, in standard deviations, contact ``since`` before the first sample.

    The state at the first sample and the law's coefficients are found in turn.
    """
    t, d, lost, v, x, x_integral, weight, fall = blocks[:8]
    o = offset[..., None]
    d, lost, v = d - o, lost - o * t, v + o * t
    x, x_integral = x + o * t**2 / 2, x_integral + o * t**3 / 6
    first = np.maximum(d[..., 0], 0)
    v1 = np.clip(1 - (first - fall[:, 0]) * since, 0.2, 1)
    y = np.stack([since * (1 + v1) / 2, v1, since**2 / 2, first * since])
    for _ in range(BEGINNING.rounds):
        x1, v1, x1_integral, lost1 = y[..., None]
        path = x1_integral + x1 * t + v1 * t**2 / 2 + x_integral
        terms = law(np.stack([x1 + v1 * t + x, v1 + v, path, lost1 + lost])) * weight[..., None]
        coefficients = _not_negative(terms, d * weight)
        y = _grown(law, coefficients, since, 1 + faster, fall[:, 0])
    return d * weight - (terms @ coefficients[..., None])[..., 0]


def _grown(law: Law, coefficients: Terms, since: Moments, velocity: Moments, fall: Column) -> State:
    """(x, v, ∫x, ∫d) a time after contact, by Runge and Kutta's rule."""
    zero = np.zeros_like(since)
    y, step = np.stack([zero, velocity, zero, zero]), since / BEGINNING.steps

    def rate(y: State) -> State:
        d = (law(y) * coefficients).sum(axis=-1)
        return np.stack([y[1], fall - d, y[0], d])

    for _ in range(BEGINNING.steps):
        first = rate(y)
        second = rate(y + step / 2 * first)
        third = rate(y + step / 2 * second)
        y = y + step / 6 * (first + 2 * second + 2 * third + rate(y + step * third))
    return np.clip(np.nan_to_num(y), -3, 3)


def _not_negative(terms: Float[np.ndarray, "*row block term"], target: Residuals) -> Terms:
    """Least squares by coefficients of which none is negative: the best of all subsets of terms."""
    size = terms.shape[-1]
    gram = terms.swapaxes(-1, -2) @ terms
    moment = (target[..., None, :] @ terms)[..., 0, :]
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-300))
    gram = np.nan_to_num(gram / scale[..., None] / scale[..., None, :])
    moment = np.nan_to_num(moment / scale)
    subsets = (np.arange(1, 2**size)[:, None] >> np.arange(size) & 1).astype(float)
    # A term that is left out has a coefficient of 0.
    of_subset = gram[..., None, :, :] * subsets[:, :, None] * subsets[:, None, :]
    of_subset = of_subset + (1 - subsets)[:, :, None] * np.eye(size) + 1e-11 * np.eye(size)
    tried = np.linalg.solve(of_subset, (moment[..., None, :] * subsets)[..., None])[..., 0]
    gain = np.where((tried >= 0).all(axis=-1), (tried * moment[..., None, :]).sum(axis=-1), 0)
    best = np.take_along_axis(tried, gain.argmax(axis=-1)[..., None, None], axis=-2)[..., 0, :]
    return np.maximum(best, 0) / scale


def _less_error(residuals: Residuals, change: Residuals) -> Residuals:
    """(1 + u uᵀ)^(−1/2) r: the residuals less what an error may have made of them that changes them by u."""
    square = (change**2).sum(axis=-1, keepdims=True)
    share = (1 - 1 / np.sqrt(1 + square)) / np.maximum(square, 1e-300)
    return residuals - share * (residuals * change).sum(axis=-1, keepdims=True) * change


def _least(residuals: Residuals) -> Column:
    """The least sum of squares on the straight lines from each account to the next."""
    first, change = residuals[:-1], np.diff(residuals, axis=0)
    square = np.maximum((change**2).sum(axis=-1), 1e-300)
    share = np.clip(-(first * change).sum(axis=-1) / square, 0, 1)
    return ((first + share[..., None] * change) ** 2).sum(axis=-1).min(axis=0)
