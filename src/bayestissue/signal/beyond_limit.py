"""A deceleration beyond the sensor's limit, enough to tell until when the impactor moves into the tissue.

A spring and damper, d = a v + b x with a = C/M and b = K/M, is fitted to the samples that are not clipped by
least squares, contact lying between the moments that the recording leaves open; where it is within the limit
though the sample is clipped, that counts as an error too. No likelihood is asked of what it says beyond the
limit.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from bayestissue.signal.settings import BEYOND_LIMIT
from bayestissue.signal.start import deceleration
from bayestissue.signal.traces import Column, Recordings, Rows


def beyond_limit(
    decelerations: Recordings,
    clipped: Rows,
    velocity: Column,
    gravity: Column,
    bracket: tuple[Column, Column],
) -> Rows:
    """The deceleration with the fitted one in place of samples at the limit, if it lies beyond.

    Args:
        decelerations: from the first sample in contact on, offset removed, m/s².
        clipped: [impact, sample], 1 or -1 where a sample is at the limit, else 0.
        velocity: [impact], at contact, m/s.
        gravity: [impact], along the motion, m/s².
        bracket: [impact], from contact to the first sample, s, at the least and at the most.
    """
    whole, times = decelerations.value.copy(), decelerations.time_s
    for row in np.flatnonzero(clipped.any(axis=1)):
        here = slice(0, decelerations.n[row])
        bounds = float(bracket[0][row]), float(bracket[1][row])
        d, sign = whole[row, here], clipped[row, here]
        fitted = _fitted(d, sign, times[row, here], velocity[row], gravity[row], bounds)
        if fitted is not None:
            whole[row, here] = np.where(sign * fitted > sign * d, fitted, d)
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
    gone = np.flatnonzero((d < BEYOND_LIMIT.pushes * limit) & (np.arange(d.size) > last))
    end = int(gone[0]) if gone.size else d.size
    lasts = time[end - 1] + bounds[1]
    if end < BEYOND_LIMIT.fewest or not lasts > 0:
        return None
    # After the plateau as long as it took, and no longer: what comes back is another law.
    stop = min(end, last + 1 + max(BEYOND_LIMIT.fewest, int(np.count_nonzero(sign)) // 2))
    part, near = slice(0, stop), sign[:stop]

    def residuals(logs: np.ndarray) -> np.ndarray:
        difference = (deceleration(logs, time[part], velocity, gravity) - d[part]) / limit
        return np.where(near == 0, difference, np.minimum(near * difference, 0.0))

    best = None
    for share in BEYOND_LIMIT.starts:
        omega = np.pi * share / lasts
        start = np.array([np.log(0.4 * omega), 2 * np.log(omega), (bounds[0] + bounds[1]) / 2])
        wide = 1e-9 * lasts
        low = np.array([np.log(1e-3 * omega), 2 * np.log(0.1 * omega), bounds[0] - wide])
        high = np.array([np.log(1e2 * omega), 2 * np.log(1e2 * omega), bounds[1] + wide])
        fit = least_squares(residuals, start, bounds=(low, high), x_scale=[1.0, 1.0, lasts])
        best = fit if best is None or fit.cost < best.cost else best
        if best.cost < BEYOND_LIMIT.well * stop:
            break
    return None if best is None else deceleration(best.x, time, velocity, gravity)
