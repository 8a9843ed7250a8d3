"""Cumulative integrals over the samples of each impact."""

from __future__ import annotations

from typing import Literal

import numpy as np

from bayestissue.signal.traces import Recordings, Rows

type Rule = Literal["trapezoidal", "quintic"]


# The integral over one interval of the quintic through six even samples, three on either side, times 1440.
_WEIGHTS = np.array([11.0, -93.0, 802.0, 802.0, -93.0, 11.0]) / 1440
# The same quintic one and two intervals before the first of its six samples.
_ONE_BEYOND = np.array([6.0, -15.0, 20.0, -15.0, 6.0, -1.0])
_TWO_BEYOND = np.array([21.0, -70.0, 105.0, -84.0, 35.0, -6.0])


def cumulative(recordings: Recordings, rule: Rule) -> Rows:
    """∫ value dt from the first sample of each row to each of its samples; the first is 0.

    trapezoidal: (Δ/2)(y_j + y_{j+1}); its relative error for e^{μt} is (μΔ)²/12.
    quintic: (Δ/1440)(11 y_{j−2} − 93 y_{j−1} + 802 y_j + 802 y_{j+1} − 93 y_{j+2} + 11 y_{j+3}), exact for
    quintics; its relative error is 191(μΔ)⁶/60480. Beyond either end the quintic through the six samples
    nearest to that end takes the place of the missing ones. Rows of fewer than six samples get the
    trapezoidal rule. What stands past a row's end is meaningless.
    """
    y, dt = recordings.value, recordings.dt[:, None]
    steps = (y[:, 1:] + y[:, :-1]) / 2
    if rule == "quintic" and y.shape[1] >= 6:
        padded, width = _extended(recordings), steps.shape[1]
        quintic = sum(weight * padded[:, k : k + width] for k, weight in enumerate(_WEIGHTS))
        steps = np.where(recordings.n[:, None] >= 6, quintic, steps)
    return np.concatenate([np.zeros((len(y), 1)), np.cumsum(steps * dt, axis=1)], axis=1)


def _extended(recordings: Recordings) -> Rows:
    y, n = recordings.value, recordings.n
    rows = np.arange(len(y))
    begin = y[:, :6]
    end = np.stack([y[rows, np.maximum(n - 1 - lag, 0)] for lag in range(6)], axis=1)
    padded = np.pad(y, ((0, 0), (2, 2)))
    padded[:, 1], padded[:, 0] = begin @ _ONE_BEYOND, begin @ _TWO_BEYOND
    padded[rows, n + 2], padded[rows, n + 3] = end @ _ONE_BEYOND, end @ _TWO_BEYOND
    return padded
