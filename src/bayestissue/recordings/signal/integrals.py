"""Integrals and derivatives over the samples of each impact."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

from bayestissue.recordings.signal.padded_traces import Column, PaddedTraces, Rows
from bayestissue.recordings.signal.signal_settings import WINDOW

type Rule = Literal["trapezoidal", "quintic"]


# The integral over one interval of the quintic through six even samples, three on either side, times 1440.
_WEIGHTS = np.array([11.0, -93.0, 802.0, 802.0, -93.0, 11.0]) / 1440
# The polynomial through the nearest eight, or six, samples at one and two intervals beyond the first of them.
_BEYOND = {
    8: np.array([[8, -28, 56, -70, 56, -28, 8, -1], [36, -168, 378, -504, 420, -216, 63, -8]], float),
    6: np.array([[6, -15, 20, -15, 6, -1], [21, -70, 105, -84, 35, -6]], float),
}


def cumulative(recordings: PaddedTraces, rule: Rule) -> Rows:
    """∫ value dt from the first sample of each row to each of its samples; the first is 0.

    trapezoidal: (Δ/2)(y_j + y_{j+1}); its relative error for e^{μt} is (μΔ)²/12.
    quintic: (Δ/1440)(11 y_{j−2} − 93 y_{j−1} + 802 y_j + 802 y_{j+1} − 93 y_{j+2} + 11 y_{j+3}), exact for
    quintics; its relative error is 191(μΔ)⁶/60480. Beyond either end the polynomial through the eight samples
    nearest to that end takes the place of the missing ones: a quintic's error there is several times the
    central one, and an error in the first intervals moves all later values. Rows of six or seven samples
    make do with the quintic at their ends, and shorter ones get the trapezoidal rule. What stands past a
    row's end is meaningless. Of uneven times the trapezia are those of the times that there are, and a cubic
    spline through the samples takes the quintics' place; its error is of fourth order in the step.
    """
    y, dt, uneven = recordings.value, recordings.dt[:, None], recordings.uneven
    if rule == "trapezoidal" or y.shape[1] < 6:
        return trapezoids(y, np.where(uneven[:, None], np.diff(recordings.time_s, axis=1), dt))
    padded, width = _extended(recordings), y.shape[1] - 1
    quintic = sum(weight * padded[:, k : k + width] for k, weight in enumerate(_WEIGHTS))
    steps = np.where(recordings.n_samples[:, None] >= 6, quintic, (y[:, 1:] + y[:, :-1]) / 2)
    integral = np.concatenate([np.zeros((len(y), 1)), np.cumsum(steps * dt, axis=1)], axis=1)
    # Imported here as in `derivatives`.
    from scipy.interpolate import CubicSpline

    for row in np.flatnonzero(uneven & (recordings.n_samples > 1)):
        inside = slice(recordings.n_samples[row])
        time = recordings.time_s[row, inside]
        integral[row, inside] = CubicSpline(time, y[row, inside]).antiderivative()(time)
    return integral


def trapezoids(
    y: Float[np.ndarray, "*row sample"], dt: float | Float[np.ndarray, "*row step"]
) -> Float[np.ndarray, "*row sample"]:
    """∫ y dt from the first sample to each, by the trapezoidal rule along the last axis; the first is 0."""
    steps = (y[..., 1:] + y[..., :-1]) / 2 * dt
    return np.concatenate([np.zeros_like(y[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)


def _extended(recordings: PaddedTraces) -> Rows:
    y, n = recordings.value, recordings.n_samples
    rows = np.arange(len(y))
    padded = np.pad(y, ((0, 0), (2, 2)))
    for points, chosen in ((6, rows[n < 8]), (8, rows[n >= 8])):
        first, last = np.arange(points), n[chosen, None] - 1 - np.arange(points)
        before = _BEYOND[points] @ y[chosen[:, None], first].T
        after = _BEYOND[points] @ y[chosen[:, None], np.maximum(last, 0)].T
        padded[chosen, 1], padded[chosen, 0] = before
        padded[chosen, n[chosen] + 2], padded[chosen, n[chosen] + 3] = after
    return padded


def clear_velocity(recordings: PaddedTraces, velocity: Rows, noise_sd: Column) -> Rows:
    """Velocity (m/s) of displacements in which the noise is but a few per cent of the greatest.

    Slope of parabolas fitted over 5 ms, or over twice or four times as long where noise asks for it. Where a
    noisy velocity first reaches 0 is where the noise has made it.

    Args:
        recordings: displacements, m.
        velocity: that of `derivatives`, m/s.
        noise_sd: standard deviation of white noise on each, m.
    """
    greatest = np.where(recordings.inside, velocity, 0.0).max(axis=1)
    over_s, n = WINDOW.smoothing_s, _parabola(recordings, WINDOW.smoothing_s)
    for _ in range(2):
        # Of the slope of a straight line through n samples; fewer than three have none.
        of_noise = noise_sd * np.sqrt(12 / max(n * (n**2 - 1), 24)) / recordings.dt
        noisy = of_noise > WINDOW.clear * greatest
        if not noisy.any():
            break
        over_s *= 2
        n = _parabola(recordings, over_s)
        velocity = np.where(noisy[:, None], derivatives(recordings, over_s)[0], velocity)
    return velocity


def _parabola(recordings: PaddedTraces, over_s: float) -> int:
    """How many samples a parabola is fitted to: an odd number, and no more than there are."""
    width = max(5, 2 * round(over_s / np.median(recordings.dt) / 2) + 1)
    return int(min(width, recordings.value.shape[1] - 1 + recordings.value.shape[1] % 2))


def derivatives(recordings: PaddedTraces, over_s: float = WINDOW.smoothing_s) -> tuple[Rows, Rows]:
    """Velocity (m/s) and deceleration (m/s²) of displacements.

    Slope and minus curvature of parabolas fitted over 5 ms (at least five samples) around each sample.
    """
    # A third of a second to import, which recordings of the deceleration need not wait for.
    from scipy.signal import savgol_filter

    width = _parabola(recordings, over_s)
    if width < 3:
        return np.zeros_like(recordings.value), np.zeros_like(recordings.value)
    slope = savgol_filter(recordings.held, width, 2, deriv=1, axis=1) / recordings.dt[:, None]
    curvature = savgol_filter(recordings.held, width, 2, deriv=2, axis=1) / recordings.dt[:, None] ** 2
    return slope, -curvature
