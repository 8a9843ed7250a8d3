"""A deceleration beyond the sensor's limit, enough to tell until when the impactor moves into the tissue.

A spring and damper, d = a v + b x with a = C/M and b = K/M, is fitted to the samples that are not clipped by
least squares, contact lying between the moments that the recording leaves open; where it is within the limit
though the sample is clipped, that counts as an error too. No likelihood is asked of what it says beyond the
limit.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayestissue.signal.traces import Column, Mask, Rows

# Of the force's duration above a fifth of the limit: half a period of the oscillations that are tried first.
_STARTS = (0.7, 1.0, 1.6)
# Of the limit: below it, after the plateau, the tissue may no longer push as it did.
_PUSHES = 0.2
_FEWEST = 4
# Half of a squared error of 4 % of the limit: no other start is tried.
_WELL = 8e-4


def beyond_limit(
    d: Rows,
    clipped: Rows,
    inside: Mask,
    time: Rows,
    velocity: Column,
    gravity: Column,
    least: Column,
    most: Column,
) -> Rows:
    """The deceleration with the fitted one in place of samples at the limit, if it lies beyond.

    Args:
        d: [impact, sample], from the first sample in contact on, offset removed, m/s².
        clipped: [impact, sample], 1 or -1 where a sample is at the limit, else 0.
        inside: [impact, sample], where there is a sample.
        time: [impact, sample], since the first sample, s.
        velocity: [impact], at contact, m/s.
        gravity: [impact], along the motion, m/s².
        least: [impact], from contact to the first sample, s, at the least.
        most: [impact], and at the most.
    """
    whole = d.copy()
    for row in np.flatnonzero(clipped.any(axis=1)):
        here = np.flatnonzero(inside[row])
        bounds = float(least[row]), float(most[row])
        sign = clipped[row, here]
        fitted = _fitted(d[row, here], sign, time[row, here], velocity[row], gravity[row], bounds)
        if fitted is not None:
            whole[row, here] = np.where(sign * fitted > sign * d[row, here], fitted, d[row, here])
    return whole


def _fitted(
    d: Float[np.ndarray, " sample"],
    sign: Float[np.ndarray, " sample"],
    time: Float[np.ndarray, " sample"],
    velocity: float,
    gravity: float,
    bounds: tuple[float, float],
) -> Float[np.ndarray, " sample"] | None:
    # A third of a second to import, which other recordings need not wait for.
    from scipy.optimize import least_squares

    limit, last = float(np.abs(d[sign != 0]).max()), int(np.flatnonzero(sign)[-1])
    gone = np.flatnonzero((d < _PUSHES * limit) & (np.arange(d.size) > last))
    end = int(gone[0]) if gone.size else d.size
    lasts = time[end - 1] + bounds[1]
    if end < _FEWEST or not lasts > 0:
        return None
    # After the plateau as long as it took, and no longer: what comes back is another law.
    stop = min(end, last + 1 + max(_FEWEST, int(np.count_nonzero(sign)) // 2))
    part, near = slice(0, stop), sign[:stop]

    def model(logs: np.ndarray, since: np.ndarray) -> np.ndarray:
        a, b = np.exp(logs[:2])
        root = np.sqrt(complex(a**2 / 4 - b)) + 1e-6 * np.sqrt(b)
        first, second = -a / 2 + root, -a / 2 - root
        v, bend = (
            (first**k * np.exp(first * since) - second**k * np.exp(second * since)) / (first - second)
            for k in (1, 2)
        )
        return (-velocity * bend + gravity * (1 - v)).real

    def left(logs: np.ndarray) -> np.ndarray:
        difference = (model(logs, time[part] + logs[2]) - d[part]) / limit
        return np.where(near == 0, difference, np.minimum(near * difference, 0.0))

    best, least_left = None, np.inf
    for share in _STARTS:
        omega = np.pi * share / lasts
        start = np.array([np.log(0.4 * omega), 2 * np.log(omega), (bounds[0] + bounds[1]) / 2])
        wide = 1e-9 * lasts
        low = np.array([np.log(1e-3 * omega), 2 * np.log(0.1 * omega), bounds[0] - wide])
        high = np.array([np.log(1e2 * omega), 2 * np.log(1e2 * omega), bounds[1] + wide])
        fit = least_squares(left, start, bounds=(low, high), x_scale=[1.0, 1.0, lasts])
        if fit.cost < least_left:
            best, least_left = fit.x, fit.cost
        if least_left < _WELL * stop:
            break
    return None if best is None else model(best, time + best[2])
