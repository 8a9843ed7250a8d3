"""A low-pass that was not declared: a rise at contact that is slower than the sampling, and no tissue's.

A spring and damper's force jumps at contact. Behind a filter with the answer s(t) to a step, and r(t) to a
ramp, what is recorded is

    y = a (V s(t - c) - int y) + b (V r(t - c) - int int y),  a = C / M, b = K / M,

since filtering and integrating commute: linear in a and b once the moment of contact c and the corner are
given. Gravity g along the motion adds a g r + b g int r. A grid of both is tried, of a filter of the second
order. Elements whose force rises from 0, as Maxwell's and a ball's do, rise slowly too: what is found is a
filter only where it leaves noise alone, and no law of depth and velocity comes near that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from bayestissue.dataset.settings import LowPassFilter
from bayestissue.signal.displacement import BEFORE, Displacements
from bayestissue.signal.filters import answers
from bayestissue.signal.integration import trapezoids
from bayestissue.signal.quality import law
from bayestissue.signal.settings import LAW, PULSE, SAMPLES
from bayestissue.signal.start import deceleration
from bayestissue.signal.traces import Column


@dataclass(frozen=True)
class Suspected:
    """What each recording says of a low-pass.

    Attributes:
        corner_hz: of the second-order Butterworth filter that explains it, Hz; NaN where there is no need of
            one.
        change_K, change_C: K and C without the filter over those with it, less 1.
    """

    corner_hz: Column
    change_K: Column
    change_C: Column


def suspected(signal: Displacements) -> Suspected:
    """Ask every recording for a low-pass of 20 Hz to a quarter of the sampling rate.

    Args:
        signal: decelerations from contact to zero velocity.
    """
    used = np.arange(signal.x.shape[1]) < signal.n_samples[:, None]
    peak = np.where(used, signal.deceleration, 0).max(axis=1)
    with np.errstate(all="ignore"):
        plain = law.least_sum_of_squares(signal, used)
    variance = signal.noise_sd**2 + (LAW.misfit * peak) ** 2
    freedom = np.maximum(PULSE.worth * signal.n_samples, 1)
    count = np.maximum(signal.n_samples - 4, 1)
    odd = fdtrc(count, freedom, plain / count / variance) < SAMPLES.alarms
    columns = np.full((len(peak), 3), np.nan)
    # A filter is tried on even times.
    tried = odd & (signal.n_samples >= 12) & (signal.n_before >= 4) & ~signal.uneven
    tried &= ~signal.clipped.any(axis=1)
    for row in np.flatnonzero(tried):
        columns[row] = _explanation(signal, int(row), plain[row], variance[row], freedom[row])
    return Suspected(*columns.T)


def _explanation(
    signal: Displacements, row: int, plain: float, variance: float, freedom: float
) -> tuple[float, float, float]:
    """Corner and changes of K and C of one impact; NaN where no filter explains it better than a law."""
    dt, velocity, n = signal.dt[row], signal.velocity[row], signal.n_samples[row]
    gravity = signal.gravity[row]
    early = min(int(signal.n_before[row]), BEFORE)
    y = np.concatenate([signal.before[row, BEFORE - early :], signal.deceleration[row, :n]])
    time = (np.arange(len(y)) - early) * dt
    lost = trapezoids(y, dt)
    twice = trapezoids(lost, dt)
    lowest = max(20.0, 1 / (signal.dt[row] * n))
    best: tuple[float, float, np.ndarray] = (np.inf, np.nan, np.zeros(2))
    for corner in np.geomspace(lowest, max(0.25 / dt, 1.01 * lowest), LAW.corners):
        moments = np.linspace(-2.5 / (2 * np.pi * corner) - 3 * dt, dt, LAW.moments)
        moments = moments[moments > time[0]]
        step, ramp = answers(LowPassFilter(low_pass_hz=corner), time - moments[:, None])
        gained = velocity * step + gravity * ramp, velocity * ramp + gravity * trapezoids(ramp, dt)
        terms = np.stack([gained[0] - lost, gained[1] - twice])
        squares, coefficients = _fitted(terms, y)
        column = int(np.argmin(squares))
        if squares[column] < best[0]:
            best = (float(squares[column]), float(corner), coefficients[:, column])
    square, corner, (a, b) = best
    # The law was fitted from the first sample in contact on.
    number = len(y) - 4
    well = fdtrc(number, freedom, square / number / variance) > LAW.noise_alone
    better = plain - square + early * variance > LAW.gain * variance
    inside = lowest * 1.01 < corner < 0.24 / dt
    if not (well and better and inside and a > 0 and b > 0):
        return np.nan, np.nan, np.nan
    a_plain, b_plain = _without_filter(signal, row, float(a), float(b))
    return corner, b_plain / float(b) - 1, a_plain / float(a) - 1


def _without_filter(signal: Displacements, row: int, a: float, b: float) -> tuple[float, float]:
    """The a and b nearest to the samples of an impact behind no filter, as a fit has them."""
    from scipy.optimize import least_squares

    n, velocity, gravity = signal.n_samples[row], signal.velocity[row], signal.gravity[row]
    time, y = np.arange(n) * signal.dt[row], signal.deceleration[row, :n]
    reach = np.sqrt(3) * signal.bracket_sd[row] + 1e-12

    def residuals(logs: np.ndarray) -> np.ndarray:
        return deceleration(logs, time, velocity, gravity) - y

    start, reaches = np.array([np.log(a), np.log(b), signal.bracket_s[row]]), [np.inf, np.inf, reach]
    bounds = start - reaches, start + reaches
    solution = least_squares(residuals, start, bounds=bounds, x_scale=[1, 1, reach])
    return float(np.exp(solution.x[0])), float(np.exp(solution.x[1]))


def _fitted(
    terms: Float[np.ndarray, "term *moment sample"], y: Float[np.ndarray, " sample"]
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of y in two terms: the sum of squares left, and both coefficients."""
    (p, q), total = terms, (y**2).sum()
    pp, pq, qq, py, qy = ((a * b).sum(-1) for a, b in ((p, p), (p, q), (q, q), (p, y), (q, y)))
    determinant = pp * qq - pq**2
    first, second = (qq * py - pq * qy) / determinant, (pp * qy - pq * py) / determinant
    return total - first * py - second * qy, np.stack([first, second])
