"""Recordings of the displacement itself: contact, velocity and the moment of zero velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayestissue.signal.contact import from_time_zero
from bayestissue.signal.options import SignalOptions
from bayestissue.signal.traces import Column, Index, Mask, Recordings, Rows, at, first_where, last_where
from bayestissue.signal.window import Stop

# Derivatives are those of a parabola fitted over about this long: a millimetre's tenth of noise at 1 kHz
# then leaves a few per cent of noise on the velocity of a heel strike.
_SMOOTHING_S = 0.005
# A motion that some other force keeps going counts as stopped where it is slowest, below this fraction of V.
_SLOW = 0.25


def contact_sample(recordings: Recordings, options: SignalOptions) -> tuple[Index, Column]:
    """The first sample at or after contact, and the seconds from contact to it.

    automatic: displacement is counted into the tissue, so contact is where it last passes 0 on its way up
    to the peak, or the first sample where the recording begins above 0. threshold: where it passes that
    fraction of its peak. time-zero: time 0.
    """
    if options.contact == "time-zero":
        return from_time_zero(recordings)
    x = np.where(recordings.inside, recordings.value, -np.inf)
    top = np.argmax(x, axis=1)
    level = options.threshold * x.max(axis=1) if options.contact == "threshold" else np.zeros(len(x))
    until_peak = np.arange(x.shape[1]) <= top[:, None]
    # A rest of exact zeros, as a coarse recorder writes it, is before contact; its last zero may be contact.
    still = np.pad((x[:, :-1] == level[:, None]) & (x[:, 1:] == level[:, None]), ((0, 0), (0, 1)))
    first = last_where(((x < level[:, None]) | still) & until_peak) + 1
    above, below = at(recordings.value, first), at(recordings.value, first - 1)
    rise = np.where(above > below, above - below, 1)
    return first, np.where(first > 0, (above - level) / rise, 0) * recordings.dt


@dataclass(frozen=True)
class Derivatives:
    """Velocity (m/s) and deceleration (m/s²) of a displacement, by local parabolas."""

    velocity: Rows
    deceleration: Rows


def derivatives(recordings: Recordings) -> Derivatives:
    """Slope and minus curvature of parabolas fitted over 5 ms (at least five samples) around each sample."""
    # A third of a second to import, which recordings of the deceleration need not wait for.
    from scipy.signal import savgol_filter

    dt = np.median(recordings.dt)
    width = max(5, 2 * round(_SMOOTHING_S / dt / 2) + 1)
    width = min(width, recordings.value.shape[1] - 1 + recordings.value.shape[1] % 2)
    if width < 3:
        return Derivatives(np.zeros_like(recordings.value), np.zeros_like(recordings.value))
    index = np.minimum(np.arange(recordings.value.shape[1]), recordings.n[:, None] - 1)
    level = np.take_along_axis(recordings.value, index, axis=1)
    slope = savgol_filter(level, width, 2, deriv=1, axis=1) / recordings.dt[:, None]
    curvature = savgol_filter(level, width, 2, deriv=2, axis=1) / recordings.dt[:, None] ** 2
    return Derivatives(slope, -curvature)


def slowest(v: Rows, x: Rows, inside: Mask, dt: Column, velocity: Column) -> Stop:
    """Zero velocity, or, where it isn't reached, the first place where the motion is slowest.

    Args:
        v: [impact, sample] from the first sample in contact on, m/s.
        x: [impact, sample], m.
        inside: [impact, sample].
        dt: [impact], s.
        velocity: [impact], at contact, m/s.
    """
    last = inside.sum(axis=1) - 1
    passed = (v <= 0) & inside
    reached = passed.any(axis=1)
    slower = np.pad(v[:, 1:] >= v[:, :-1], ((0, 0), (0, 1))) & (v < _SLOW * velocity[:, None]) & inside
    index = np.where(reached, first_where(passed, last), first_where(slower, last))
    before = np.maximum(index - 1, 0)
    v0, v1 = at(v, before), at(v, index)
    s = np.where(reached & (v0 > v1), v0 / np.where(v0 > v1, v0 - v1, 1), index - before)
    s = np.clip(s, 0, 1)
    return Stop(index, (before + s) * dt, at(x, before) + s * (at(x, index) - at(x, before)), reached)
