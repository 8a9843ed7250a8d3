"""The moment of zero velocity, and which samples an estimate uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayestissue.signal.options import Window
from bayestissue.signal.settings import CONTACT, WINDOW
from bayestissue.signal.traces import Column, Index, Mask, Recordings, Rows, at, first_where, last_where


@dataclass(frozen=True)
class Stop:
    """Zero velocity: the first sample at or past it, its time since the first sample (s), and x there (m).

    Where the velocity does not reach zero before the tissue stops pushing, the last sample until then stands
    in; ``reached`` is false unless hardly any velocity is left there.
    """

    index: Index
    time: Column
    x: Column
    reached: Mask


def still_pushed(decelerations: Recordings, noise_sd: Column) -> Mask:
    """The samples up to the last one with a force clear of the noise; all of them where there is none."""
    clear = (decelerations.value > CONTACT.certain * noise_sd[:, None]) & decelerations.inside
    last = np.where(clear.any(axis=1), last_where(clear), clear.shape[1])
    return np.arange(clear.shape[1]) <= last[:, None]


def zero_velocity(slowing: Recordings, v: Rows, x: Rows, pushed: Mask, velocity: Column) -> Stop:
    """Zero velocity by the cubic that has the velocities and decelerations of the samples on either side.

    A mass that a strong damper stops comes back so slowly that errors of a thousandth of the velocity at
    contact may leave it above zero for good. What comes after the force is no motion on the tissue.

    Args:
        slowing: decelerations that change the velocity, m/s².
        v: [impact, sample], m/s.
        x: [impact, sample], m.
        pushed: [impact, sample], where the tissue still pushes or will again.
        velocity: [impact], at contact, m/s.
    """
    sample_number, dt = slowing.sample_numbers, slowing.dt
    last = pushed.sum(axis=1) - 1
    passed = (v <= 0) & pushed
    index = first_where(passed, last)
    left = (last < slowing.n - 1) & (at(v, last) < WINDOW.stopped * velocity)
    reached = passed.any(axis=1)
    before = np.maximum(index - 1, 0)
    v0, v1 = at(v, before), at(v, index)
    apart = at(sample_number, index) - at(sample_number, before)
    step = apart * dt
    m0, m1 = (-at(slowing.value, sample) * step for sample in (before, index))
    # v(s) = v0 + m0 s + p s² + q s³ over the interval, s from 0 to 1.
    p, q = 3 * (v1 - v0) - 2 * m0 - m1, m0 + m1 - 2 * (v1 - v0)
    s = v0 / np.where(v0 > v1, v0 - v1, 1)
    for _ in range(4):
        slope = m0 + 2 * p * s + 3 * q * s**2
        change = (v0 + m0 * s + p * s**2 + q * s**3) / np.where(slope < 0, slope, -1)
        s = np.clip(s - np.where(slope < 0, change, 0), 0, 1)
    s = np.where(reached & (index > 0), s, index - before)
    travelled = (v0 * s + m0 * s**2 / 2 + p * s**3 / 3 + q * s**4 / 4) * step
    x_stop = np.where(reached, at(x, before) + travelled, at(x, last))
    return Stop(index, (at(sample_number, before) + s * apart) * dt, x_stop, reached | left)


def slowest(displacements: Recordings, v: Rows, velocity: Column) -> Stop:
    """Zero velocity, or, where it isn't reached, the first place where the motion is slowest.

    Args:
        displacements: from the first sample in contact on, m.
        v: [impact, sample], m/s.
        velocity: [impact], at contact, m/s.
    """
    x, inside, last = displacements.value, displacements.inside, displacements.n - 1
    passed = (v <= 0) & inside
    reached = passed.any(axis=1)
    slower = np.pad(v[:, 1:] >= v[:, :-1], ((0, 0), (0, 1))) & (v < WINDOW.slow * velocity[:, None]) & inside
    index = np.where(reached, first_where(passed, last), first_where(slower, last))
    before = np.maximum(index - 1, 0)
    v0, v1 = at(v, before), at(v, index)
    s = np.where(reached & (v0 > v1), v0 / np.where(v0 > v1, v0 - v1, 1), index - before)
    s = np.clip(s, 0, 1)
    x_stop = at(x, before) + s * (at(x, index) - at(x, before))
    return Stop(index, (before + s) * displacements.dt, x_stop, reached)


def samples_in(
    window: Window, stop: Stop, since_contact: Column, decelerations: Recordings, x: Rows, noise_sd: Column
) -> Index:
    """How many samples from the first one on lie in the window.

    rebound ends where, after zero velocity, d falls below 2 % of its peak or three noise standard deviations
    (the tissue no longer pushes) or x is back at 0.
    """
    d, inside = decelerations.value, decelerations.inside
    if window == "rebound":
        floor = np.maximum(0.02 * np.where(inside, d, 0).max(axis=1), 3 * noise_sd)
        over = (d <= floor[:, None]) | (x <= 0)
        late = np.arange(d.shape[1]) >= stop.index[:, None]
        return first_where(over & inside & late, decelerations.n)
    fraction = 1.0 if window == "peak" else float(window)
    until = fraction * (since_contact + stop.time) - since_contact
    return np.sum(inside & (decelerations.time_s <= (until + 1e-9 * decelerations.dt)[:, None]), axis=1)
