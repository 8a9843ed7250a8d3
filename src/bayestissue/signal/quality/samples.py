"""What is wrong with single samples: spikes, values that stand still, steps too coarse."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from bayestissue.signal.quality.recorded import Recorded
from bayestissue.signal.traces import Column, Index, Mask, Rows

_WIDEST = 3
_SIDE = 4
# A fraction of the peak: a spike of three samples among fifteen until the peak then moves K by some 3 %.
_HIGH = 0.1
_LEVELS = 20
_ALARMS = 1e-3
# The line before a jump misses so many times more than that behind it; of a decay by e in a sampling interval
# nothing is left to tell its rate from.
_JUMP, _FASTEST = 2.0, 1.0


def spikes(recorded: Recorded) -> Index:
    """The first sample of the highest spike of one to three samples; -1 where there is none.

    The straight lines through the four samples on either side both miss it, in the same direction, by more
    than noise does in a thousandth of all recordings and by a tenth of the peak; a cubic through all eight
    misses it too, which a pulse of few samples does not. A force that jumps at contact and decays at once, as
    a strong damper's, is missed by the line behind it, and not by an exponential.
    """
    value, width = recorded.value, recorded.value.shape[1]
    best, spike = np.zeros(len(value)), np.full(len(value), -1)
    quiet = recorded.before.sum(axis=1, keepdims=True)
    level = np.where(recorded.before, value, 0.0).sum(axis=1, keepdims=True) / np.maximum(quiet, 1)
    for wide in range(1, _WIDEST + 1):
        window = 2 * _SIDE + wide
        if width < window:
            break
        offsets = np.concatenate([np.arange(_SIDE), np.arange(_SIDE) + _SIDE + wide])
        middle = (window - 1) / 2
        t = offsets - middle
        left, right = _predicting(t[:_SIDE], 1), _predicting(t[_SIDE:], 1)
        either_side = _predicting(t, 3)
        views = np.lib.stride_tricks.sliding_window_view(value, window, axis=1)
        at_spike = views[..., _SIDE : _SIDE + wide].mean(axis=-1)
        before, behind = views[..., :_SIDE], views[..., _SIDE + wide :]
        misses = [
            at_spike - before @ left,
            at_spike - behind @ right,
            at_spike - views[..., offsets] @ either_side,
        ]
        jumps = np.abs(misses[0]) > _JUMP * np.abs(misses[1])
        decayed = at_spike - _decaying(level, behind, wide)
        toward = np.sign(misses[0])
        misses[1] = np.where(jumps, toward * np.minimum(toward * misses[1], toward * decayed), misses[1])
        same = (np.sign(misses[0]) == np.sign(misses[1])) & (np.sign(misses[0]) == np.sign(misses[2]))
        least = np.where(same, np.min(np.abs(misses), axis=0), 0.0)
        chance = -ndtri(_ALARMS / 2 / _WIDEST / np.maximum(recorded.inside.sum(axis=1), 1))
        error = recorded.sd * np.sqrt(1 / wide + max(float(w @ w) for w in (left, right, either_side)))
        limit = np.maximum(chance * error, _HIGH * recorded.peak)
        least = np.where(recorded.inside[:, window - 1 :], least, 0.0)
        highest = least.max(axis=1)
        here = np.argmax(least, axis=1) + _SIDE
        better = (highest > limit) & (highest > best)
        best, spike = np.where(better, highest, best), np.where(better, here, spike)
    return spike


def _decaying(level: np.ndarray, behind: np.ndarray, wide: int) -> np.ndarray:
    """What a decay to ``level`` was, on average, over ``wide`` samples before those of ``behind``.

    Its rate is that of the halves of ``behind``.
    """
    halves = [part.mean(axis=-1) - level for part in np.split(behind, 2, axis=-1)]
    with np.errstate(all="ignore"):
        rate = np.nan_to_num(np.clip(np.log(halves[0] / halves[1]) / (_SIDE / 2), 0.0, _FASTEST))
    earlier, later = (np.mean([np.exp(-rate * t) for t in range(count)], axis=0) for count in (wide, _SIDE))
    return level + (behind.mean(axis=-1) - level) * np.exp(rate * wide) * earlier / later


def _predicting(t: np.ndarray, degree: int) -> np.ndarray:
    """Weights of samples at ``t`` whose sum is the value at 0 of the polynomial through them."""
    return np.linalg.pinv(np.vander(t, degree + 1, increasing=True))[0]


def standing(recorded: Recorded) -> Index:
    """How many samples of the pulse repeat the one before, where a moving signal would not; else 0.

    Counted where the values four samples on either side differ by more than the recorder's step and the noise
    can account for; two neighbours of independent noise there share a value with a probability of at most
    step / (2 pi^(1/2) sd).
    """
    value, sd = recorded.value, recorded.sd
    step = np.where(np.isfinite(recorded.step), recorded.step, 0)
    equal = (np.diff(value, axis=1) == 0) & recorded.inside[:, 1:]
    padded = np.pad(value, ((0, 0), (8, 8)), mode="edge")
    change = np.abs(padded[:, 16:] - padded[:, :-16])[:, 1:]
    moving = recorded.inside[:, 1:] & (change > (8 * step + 6 * sd)[:, None])
    chance = np.minimum(step / (2 * np.sqrt(np.pi) * sd), 1.0) * 0.5 + 0.01
    count, repeated = moving.sum(axis=1), (moving & equal).sum(axis=1)
    limit = count * chance + 3.1 * np.sqrt(count * chance) + 2
    longest = _longest(moving & equal)
    return np.where((repeated > limit) & ((repeated > 0.3 * count) | (longest >= 3)), repeated, 0)


def _longest(condition: Mask) -> Index:
    run, best = np.zeros(len(condition), int), np.zeros(len(condition), int)
    for column in condition.T:
        run = np.where(column, run + 1, 0)
        best = np.maximum(best, run)
    return best


def levels(recorded: Recorded) -> Column:
    """The recorder's steps in the peak, where there are fewer than 20; NaN elsewhere."""
    count = recorded.peak / recorded.step
    return np.where(count < _LEVELS, count, np.nan)


__all__ = ["Rows", "levels", "spikes", "standing"]
