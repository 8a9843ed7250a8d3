"""Taps of an instrumented hammer, and how the mass that was tapped rings on.

A tap is what the hammer's force is above its noise, from the first such sample to the last, so that a hammer
that bounces has tapped once. The ringing begins when the hammer is off and ends where only noise is left.
Displacement and velocity are those of the recorded acceleration, integrated from rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from bayestissue.dataset.model import Dataset
from bayestissue.errors import Coded
from bayestissue.signal.integration import cumulative
from bayestissue.signal.options import SignalOptions
from bayestissue.signal.traces import (
    Column,
    Index,
    Mask,
    Recordings,
    Rows,
    at,
    first_where,
    from_sample,
    last_where,
    segment_moments,
    stack,
    standard_error,
)

NO_TAP = Coded("no tap: the hammer's force stays within its noise", "no-tap")
FEW_IN_TAP = Coded("few samples of the hammer's force: its impulse is rough", "rough-tap")
# Of the force's noise, and of its greatest, what a tap is above.
_ABOVE_NOISE, _ABOVE_GREATEST = 5.0, 0.01
# Rows of so many a period are as good as all samples.
_A_PERIOD = 16
# The spectrum is that of rows so many times as long.
_FINER = 8
# So many samples together ring whose root mean square is so many times the noise's; and for how much longer
# than until the last of these the ringing is looked at.
_TOGETHER, _RINGS, _LONGER = 32, 1.5, 1.25
# The quiet part ends so many samples before the tap.
_CLEAR = 3
# A sum over n samples of a half sine errs by 0.8 / n^2 at most.
_OF_SUM = 0.8
_ENOUGH = 12


@dataclass(frozen=True, eq=False)
class Taps:
    """The taps of a dataset and what came of them, in SI units.

    Attributes:
        begin: of each tap, on the recordings' clock [s].
        end: until the hammer is off, from there [s].
        impulse: what each of the force's samples adds to the hammer's impulse, the last first [N s]; 0 where
            there is none.
        dt_force: their sampling interval [s].
        impulse_sd: of the sum, by noise, zero and few samples [N s].
        n_force: how many samples of the force there are.
        averaged: how many samples of the deceleration a row is the mean of.
        ringing: rows since the hammer is off, the zero taken off [m/s^2].
        first_time: from the beginning of the tap to the middle of the first of these [s].
        n_samples: rows until only noise is left.
        zero: what was taken off [m/s^2].
        zero_sd: its standard error [m/s^2].
        noise_sd: of the decelerations [m/s^2].
        peak_depth: greatest displacement, of the acceleration integrated from rest [m].
        peak_time: when, from the beginning of the tap [s].
        x: displacement in the middle of the rows [m].
        v: velocity there [m/s].
        flags: what is wrong, and of which taps.
    """

    begin: Column
    end: Column
    impulse: Float[np.ndarray, "impact push"]
    dt_force: Column
    impulse_sd: Column
    n_force: Index
    averaged: Index
    ringing: Recordings
    first_time: Column
    n_samples: Index
    zero: Column
    zero_sd: Column
    noise_sd: Column
    peak_depth: Column
    peak_time: Column
    x: Rows
    v: Rows
    flags: dict[Coded, Mask]

    @property
    def middle(self) -> Column:
        """From the beginning of a tap to the mean time of its impulse [s]."""
        total = self.impulse.sum(axis=1)
        before_end = np.arange(self.impulse.shape[1]) * self.dt_force[:, None]
        return self.end - (before_end * self.impulse).sum(axis=1) / np.where(total > 0, total, 1.0)


def taps(dataset: Dataset, options: SignalOptions | None = None) -> Taps:
    """The taps of a dataset whose force is a hammer's.

    Args:
        dataset: accelerations, positive the way the hammer pushes, and the force.
        options: how acceleration is integrated.
    """
    options = options or SignalOptions()
    (channel,) = dataset.channels
    force, motion = stack(channel.traces), stack(dataset.traces).signed(-1.0)
    first, last, zero, noise = _touched(force)
    n_force = last - first + 1
    part = from_sample(force, first)
    backwards = n_force[:, None] - 1 - np.arange(int(n_force.max()))
    pushes = np.take_along_axis(part.value, np.maximum(backwards, 0), axis=1) - zero[:, None]
    impulse = np.where(backwards >= 0, pushes, 0.0) * force.dt[:, None]
    end = (n_force - 1) * force.dt
    total = impulse.sum(axis=1)
    scatter = noise * force.dt * np.sqrt(n_force)
    of_zero = standard_error(noise, first - _CLEAR) * end
    impulse_sd = np.sqrt(scatter**2 + of_zero**2 + (_OF_SUM / n_force**2 * total) ** 2)

    begins, off = _before(motion, part.start), _before(motion, part.start + end) + 1
    n_quiet = np.maximum(begins - _CLEAR, 0)
    offset, noise_sd = segment_moments(motion.value, n_quiet)
    motion = replace(motion, value=np.where(motion.inside, motion.value - offset[:, None], 0.0))
    touched = from_sample(motion, begins)
    v = -cumulative(touched, options.integration)
    x = cumulative(replace(touched, value=v), options.integration)
    samples = from_sample(motion, off)
    lasts = np.minimum(np.ceil(_LONGER * _rings_until(samples, noise_sd)).astype(int), samples.n)
    rings = np.arange(samples.value.shape[1]) < lasts[:, None]
    frequency = frequency_of(np.where(rings, samples.value, 0.0), samples.dt)
    averaged = np.maximum((2 * np.pi / (_A_PERIOD * frequency * samples.dt)).astype(int), 1)
    averaged = np.minimum(averaged, np.maximum(lasts // _A_PERIOD, 1))
    n = lasts // averaged
    ringing = _means(samples, averaged, n)
    first_time = ringing.start - part.start
    middle = first_time[:, None] + ringing.time_s
    shown = np.minimum(np.round(middle / motion.dt[:, None]).astype(int), x.shape[1] - 1)
    used = ringing.inside
    depth = np.where(touched.inside, np.abs(x), 0.0)
    # Integrated noise drifts: the greatest depth is that of the first swing.
    swing = np.argmax((v <= 0) & (touched.time_s > end[:, None]) & touched.inside, axis=1)
    swing = np.where(swing > 0, swing, touched.n - 1)
    depth = np.where(np.arange(depth.shape[1]) <= swing[:, None], depth, 0.0)
    deepest = depth.argmax(axis=1)
    return Taps(
        begin=part.start,
        end=end,
        impulse=impulse,
        dt_force=force.dt,
        impulse_sd=impulse_sd,
        n_force=n_force,
        averaged=averaged,
        ringing=ringing,
        first_time=first_time,
        n_samples=n,
        zero=offset,
        zero_sd=standard_error(noise_sd, n_quiet),
        noise_sd=noise_sd,
        peak_depth=depth.max(axis=1),
        peak_time=deepest * motion.dt,
        x=np.where(used, np.take_along_axis(x, shown, axis=1), 0.0),
        v=np.where(used, np.take_along_axis(v, shown, axis=1), 0.0),
        # Where even the greatest force is no tap, it is the one sample of it.
        flags={NO_TAP: n_force == 1, FEW_IN_TAP: (n_force > 1) & (n_force < _ENOUGH)},
    )


def frequency_of(value: Rows, dt: Column) -> Column:
    """Of the peak of each row's spectrum [rad/s]; rows are 0 past their end."""
    length = _FINER * value.shape[1]
    peak = np.abs(np.fft.rfft(value, length, axis=1))[:, 1:].argmax(axis=1) + 1
    frequency: np.ndarray = 2 * np.pi * peak / (length * dt)
    return frequency


def _means(ringing: Recordings, count: Index, n: Index) -> Recordings:
    """Rows of the means of so many samples each, the time that of their middle; 0 past a row's end."""
    sums = np.concatenate([np.zeros((len(n), 1)), np.cumsum(ringing.value, axis=1)], axis=1)
    edge = np.minimum(np.arange(int(n.max()) + 1) * count[:, None], sums.shape[1] - 1)
    value = np.diff(np.take_along_axis(sums, edge, axis=1)) / count[:, None]
    inside = np.arange(value.shape[1]) < n[:, None]
    start = ringing.start + (count - 1) / 2 * ringing.dt
    return Recordings(np.where(inside, value, 0.0), n, start, count * ringing.dt)


def _rings_until(ringing: Recordings, noise_sd: Column) -> Index:
    """How many samples of each row there are until only noise is left."""
    squares = np.where(ringing.inside, ringing.value, 0.0) ** 2
    squares = np.pad(squares, ((0, 0), (0, -squares.shape[1] % _TOGETHER)))
    together = squares.reshape(len(squares), -1, _TOGETHER).mean(axis=2)
    return _TOGETHER * (last_where(together > (_RINGS * noise_sd[:, None]) ** 2) + 1)


def _touched(force: Recordings) -> tuple[Index, Index, Column, Column]:
    """Of each force the first sample and the last at which the hammer touches, its zero and its noise."""
    greatest = np.where(force.inside, force.value, -np.inf).argmax(axis=1)

    def pushes(zero: Column, noise: Column) -> Mask:
        least = np.maximum(_ABOVE_NOISE * noise, _ABOVE_GREATEST * (at(force.value, greatest) - zero))
        return force.inside & (force.value - zero[:, None] > least[:, None])

    # The first half of what comes before the greatest force is quiet.
    zero, noise = segment_moments(force.value, np.maximum(greatest // 2, 1))
    early = np.arange(force.value.shape[1]) <= greatest[:, None]
    first = np.maximum(last_where(~pushes(zero, noise) & early), 0)
    zero, noise = segment_moments(force.value, np.maximum(first - _CLEAR, 1))
    last = np.minimum(last_where(pushes(zero, noise)) + 1, force.n - 1)
    return first, np.maximum(last, first), zero, noise


def _before(recordings: Recordings, moment: Column) -> Int[np.ndarray, " impact"]:
    """The last sample of each recording that is not later than a moment on its clock [s]."""
    later = recordings.start[:, None] + recordings.time_s > moment[:, None] + 1e-9 * recordings.dt[:, None]
    return np.maximum(first_where(later & recordings.inside, recordings.n) - 1, 0)
