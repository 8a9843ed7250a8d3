"""The moment of zero velocity, and which samples an estimate uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayestissue.signal.options import Window
from bayestissue.signal.traces import Column, Index, Mask, Rows, at, first_where


@dataclass(frozen=True)
class Stop:
    """Zero velocity: the first sample at or past it, its time since the first sample (s), and x there (m).

    Where the velocity never reaches zero, ``reached`` is false and the last sample stands in.
    """

    index: Index
    time: Column
    x: Column
    reached: Mask


def zero_velocity(deceleration: Rows, v: Rows, x: Rows, inside: Mask, dt: Column) -> Stop:
    """Zero velocity by the cubic that has the velocities and decelerations of the samples on either side."""
    last = inside.sum(axis=1) - 1
    passed = (v <= 0) & inside
    index = first_where(passed, last)
    reached = passed.any(axis=1)
    before = np.maximum(index - 1, 0)
    v0, v1 = at(v, before), at(v, index)
    m0, m1 = -at(deceleration, before) * dt, -at(deceleration, index) * dt
    # v(s) = v0 + m0 s + p s² + q s³ over the interval, s from 0 to 1.
    p, q = 3 * (v1 - v0) - 2 * m0 - m1, m0 + m1 - 2 * (v1 - v0)
    s = v0 / np.where(v0 > v1, v0 - v1, 1)
    for _ in range(4):
        slope = m0 + 2 * p * s + 3 * q * s**2
        step = (v0 + m0 * s + p * s**2 + q * s**3) / np.where(slope < 0, slope, -1)
        s = np.clip(s - np.where(slope < 0, step, 0), 0, 1)
    s = np.where(reached & (index > 0), s, index - before)
    travelled = (v0 * s + m0 * s**2 / 2 + p * s**3 / 3 + q * s**4 / 4) * dt
    x_stop = np.where(reached, at(x, before) + travelled, at(x, last))
    return Stop(index, (before + s) * dt, x_stop, reached)


def samples_in(
    window: Window,
    stop: Stop,
    since_contact: Column,
    deceleration: Rows,
    x: Rows,
    inside: Mask,
    dt: Column,
    noise_sd: Column,
) -> Index:
    """How many samples from the first one on lie in the window.

    rebound ends where, after zero velocity, d falls below 2 % of its peak or three noise standard deviations
    (the tissue no longer pushes) or x is back at 0.
    """
    samples = np.arange(inside.shape[1])
    if window == "rebound":
        floor = np.maximum(0.02 * np.where(inside, deceleration, 0).max(axis=1), 3 * noise_sd)
        over = (deceleration <= floor[:, None]) | (x <= 0)
        return first_where(over & inside & (samples >= stop.index[:, None]), inside.sum(axis=1))
    fraction = 1.0 if window == "peak" else float(window)
    until = fraction * (since_contact + stop.time) - since_contact
    return np.sum(inside & (samples * dt[:, None] <= until[:, None] + 1e-9 * dt[:, None]), axis=1)
