"""Whether a recording that begins above zero begins at contact, or after it, or with an offset.

The force of a spring and damper jumps at contact, so that a sound recording cropped there begins at C V / M.
With A(t) = int d and B(t) = int int d from the first sample on, in units of the time to peak and the
velocity at contact, an impact recorded with an offset o obeys

    d - o = a (v - A + (o + g) t) + b (x + v t - B + (o + g) t^2 / 2),  a = C / M, b = K / M,

g being gravity along the motion and (x, v) the state that (0, 1) grows into over the time from contact to the
first sample. Three accounts are held against each other: contact no more than a sampling interval before the
first sample and no offset; contact longer before it; an offset. What another law than that of a spring and
damper does to a trace may look like any of them: of a trace that neither of the last two explains it is asked
whether any law of tissue does.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from bayestissue.signal.displacement import Displacements
from bayestissue.signal.integration import trapezoids
from bayestissue.signal.quality import law
from bayestissue.signal.quality.recorded import Recorded
from bayestissue.signal.start import grown
from bayestissue.signal.traces import Column, Mask

# Of a sound recording, for either of the other two accounts to gain so much; and that one of these leaves
# so much where it is right.
_GAINS, _LEAVES = 0.01, 0.05
# An account has lost contact by more than so many intervals, or has a larger offset over the peak: less
# moves K by some 5 % at the most.
_LATE, _OFFSET = 1.5, 0.015
# Of the time to peak: what is looked back at the most.
_LONGEST = 0.4
# After the peak the fit ends where the force has come down to this share of it: it may let go before 0.
_ENDS = 0.3
_ROUNDS = 20
# Columns of an account: d, 1, t, A, B and t^2.
type Products = Float[np.ndarray, "impact 6 6"]
type Parameters = Float[np.ndarray, "impact 4"]


def contact_missed(recorded: Recorded, signal: Displacements, chosen: Mask) -> Mask:
    """Where a recording begins after contact or with an offset.

    Args:
        recorded: the recordings.
        signal: what is made of them, over the rebound.
        chosen: which are asked: those that begin above zero.
    """
    found, rows = np.zeros_like(chosen), np.flatnonzero(chosen)
    if not rows.size:
        return found
    d, dt, peak = signal.deceleration[rows], signal.dt[rows], recorded.peak[rows]
    sd, freedom = recorded.sd[rows], recorded.freedom[rows]
    time = np.arange(d.shape[1]) * dt[:, None]
    used = np.arange(d.shape[1]) < signal.n_samples[rows, None]
    behind = time > signal.time_to_peak[rows, None]
    until_peak = used & ~behind
    start = law.Start(dt, signal.x[rows, 0], signal.v[rows, 0], signal.gravity[rows])
    used &= np.cumsum(behind & (d < _ENDS * peak[:, None]), axis=1) == 0
    count, unit = used.sum(axis=1), signal.velocity[rows] / signal.time_to_peak[rows]
    fall = signal.gravity[rows] / unit
    products = _products(d / unit[:, None], used, dt / signal.time_to_peak[rows])
    interval = dt / signal.time_to_peak[rows]
    variance = sd**2 + (law.MISFIT * peak) ** 2

    def least(most: Column, free: int) -> tuple[Parameters, Column]:
        parameters, square = _fitted(products, fall, most, free)
        return parameters, square * unit**2

    contact = least(interval, 3)[1]
    late, of_late = least(np.full_like(interval, _LONGEST), 3)
    off, of_offset = least(interval, 4)
    missed = late[:, 2] > _LATE * interval
    shifted = np.abs(off[:, 3]) * unit > _OFFSET * peak
    for square, large in ((of_late, missed), (of_offset, shifted)):
        left = square / np.maximum(count - 3, 1)
        gain = np.maximum(contact - square, 0) / np.maximum(left, variance)
        explains = fdtrc(np.maximum(count - 3, 1), freedom, left / variance) > _LEAVES
        found[rows] |= large & explains & (fdtrc(1, np.maximum(count - 3, 1), gain) < _GAINS)
    samples = np.maximum(until_peak.sum(axis=1) - law.TERMS, 1)
    best = law.best_left(d, until_peak, start, np.ones_like(d)) / samples
    found[rows] |= fdtrc(samples, freedom, best / variance) < law.ALARMS / 2
    return found


def _products(d: np.ndarray, used: np.ndarray, interval: Column) -> Products:
    """Of the columns with each other over the samples used."""
    step = interval[:, None]
    first = trapezoids(d, step)
    time = np.arange(d.shape[1]) * step
    columns = np.stack([d, np.ones_like(d), time, first, trapezoids(first, step), time**2], axis=1)
    columns = np.where(used[:, None], columns, 0.0)
    return columns @ columns.swapaxes(1, 2)


def _weights(parameters: Parameters, fall: Column) -> Float[np.ndarray, "impact 6"]:
    """What is left over by a, b, the time since contact and o, as weights of the columns."""
    a, b, since, offset = parameters.T
    x, v = grown(a, b, since, fall)
    one, t = -offset - a * v - b * x, -b * v - a * (offset + fall)
    return np.stack([np.ones_like(a), one, t, a, b, -b * (offset + fall) / 2], axis=1)


def _fitted(products: Products, fall: Column, most: Column, free: int) -> tuple[Parameters, Column]:
    """The first ``free`` parameters by least squares, and the sum of squares that they leave.

    Contact lies up to ``most`` before the first sample. With strong damping the sum of squares may have more
    than one hollow: the best of three beginnings is taken.
    """
    best, least = np.zeros((len(most), 4)), np.full(len(most), np.inf)
    linear = np.stack([np.eye(6)[1] - np.eye(6)[3], np.eye(6)[2] - np.eye(6)[4]])
    gram = linear @ products @ linear.T
    ab = _solved(gram, (linear @ products[:, :, :1])[..., 0])
    for share in (0.05, 0.4, 0.9):
        tried = np.column_stack([ab, share * most, np.zeros_like(most)])
        for _ in range(_ROUNDS):
            tried = _stepped(products, fall, tried, list(range(free)))
            tried[:, 2] = np.clip(tried[:, 2], 0, most)
            # The others anew, with contact where it has to stay.
            tried = _stepped(products, fall, tried, [0, 1, 3][: free - 1])
        weights = _weights(tried, fall)
        square = np.einsum("ik,ikl,il->i", weights, products, weights)
        better = square < least
        best, least = np.where(better[:, None], tried, best), np.where(better, square, least)
    return best, least


def _stepped(products: Products, fall: Column, parameters: Parameters, free: list[int]) -> Parameters:
    """One step of Gauss and Newton along some of the parameters."""
    # Complex steps: the weights are polynomials, and there is no difference that could cancel.
    slopes = np.stack([_weights(parameters + 1e-30j * np.eye(4)[k], fall).imag / 1e-30 for k in free], axis=1)
    toward = slopes @ products
    change = _solved(
        toward @ slopes.swapaxes(1, 2), -(toward @ _weights(parameters, fall)[..., None])[..., 0]
    )
    stepped = parameters.copy()
    stepped[:, free] += np.nan_to_num(change)
    return stepped


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The solution, columns of the matrix scaled and next to nothing added where they are alike."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=1, axis2=2), 1e-300))
    scaled = matrix / scale[:, :, None] / scale[:, None, :]
    usable = np.isfinite(scaled).all(axis=(1, 2), keepdims=True)
    scaled = np.where(usable, scaled, 0) + (1e-12 + ~usable) * np.eye(matrix.shape[1])
    return np.linalg.solve(scaled, (right / scale)[..., None])[..., 0] / scale
