"""How far and which way each recording goes: enough to tell a wrong sign, unit or length of recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from bayestissue.dataset.model import Quantity
from bayestissue.dataset.samples import Samples


@dataclass(frozen=True, eq=False)
class Motion:
    """Of each recording, in SI units.

    Attributes:
        low, high: the least and greatest recorded value.
        peak: where the greatest displacement stands, or the greatest deceleration.
        extreme: the value farthest from the first one, less that first one.
        first_way: the sign of ``extreme``.
        pulse: how many samples exceed a tenth of the greatest deceleration; all, for displacements.
        loss, gain: the greatest speed lost (gained) between any two moments; 0 for displacements.
        pulse_loss: as ``loss``, but after taking off what the recording shows at its quieter end, so that
            an offset over a long recording counts for little.
    """

    low: Float64[np.ndarray, " impact"]
    high: Float64[np.ndarray, " impact"]
    peak: Int[np.ndarray, " impact"]
    extreme: Float64[np.ndarray, " impact"]
    first_way: Float64[np.ndarray, " impact"]
    pulse: Int[np.ndarray, " impact"]
    loss: Float64[np.ndarray, " impact"]
    gain: Float64[np.ndarray, " impact"]
    pulse_loss: Float64[np.ndarray, " impact"]


def motion(samples: Samples, quantity: Quantity) -> Motion:
    """The figures of `Motion` for every recording.

    Args:
        samples: finite, at least two per recording.
        quantity: what was recorded.
    """
    begin = samples.start[:-1]
    low = np.minimum.reduceat(samples.value, begin)
    high = np.maximum.reduceat(samples.value, begin)
    sign = -1.0 if quantity == "acceleration" else 1.0
    owner = samples.owner
    slowing = sign * samples.value
    peak = _first_at(slowing == np.maximum.reduceat(slowing, begin)[owner], begin)
    away = samples.value - samples.value[begin][owner]
    farthest = np.maximum.reduceat(np.abs(away), begin)
    extreme = away[_first_at(np.abs(away) == farthest[owner], begin)]
    none = np.zeros(begin.size)
    loss, gain, pulse_loss, pulse = none, none, none, samples.count
    if quantity != "displacement":
        pulse = np.add.reduceat((slowing > 0.1 * slowing[peak][owner]).astype(int), begin)
        rest = _rest(samples, slowing)
        step = np.append(np.maximum(np.diff(samples.time), 0), 0)
        # The step from one recording to the next means nothing.
        step[samples.start[1:] - 1] = 0
        loss = _climb(samples, slowing, step)
        pulse_loss = _climb(samples, slowing - np.maximum(rest, 0)[owner], step)
        gain = _climb(samples, np.minimum(rest, 0)[owner] - slowing, step)
    return Motion(low, high, peak, extreme, np.sign(extreme), pulse, loss, gain, pulse_loss)


def flat_top(
    samples: Samples, moving: Motion, quantity: Quantity, least: int
) -> Iterator[tuple[int, int, int, float]]:
    """Recordings cut off at one value: which, the first such sample, how many on end, and the value.

    A recorder of few bits shows equal samples at the top of a smooth or noisy peak too, but there the
    neighbours lie about one step of its scale away; at a recorder's limit they lie farther.

    Args:
        samples: all recordings.
        moving: their `Motion`.
        quantity: what was recorded; for a displacement only the peak counts.
        least: how many equal samples on end are suspicious.
    """
    begin, owner = samples.start[:-1], samples.owner
    ends = [moving.high, moving.low]
    if quantity == "displacement":
        ends = [moving.high]
    for limit in ends:
        same = samples.value == limit[owner]
        edge = np.diff(np.concatenate([[0], same.astype(np.int8), [0]]))
        run, stop = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
        long = (stop - run >= least) & (moving.high > moving.low)[owner[run]]
        for at, after in zip(run[long], stop[long], strict=True):
            which = int(owner[at])
            part = samples.value[begin[which] : samples.start[which + 1]]
            if (
                _cut(part, at - begin[which], after - begin[which])
                and abs(limit[which]) > 0.5 * np.abs(part).max()
            ):
                yield which, int(at), int(after - at), float(limit[which])
                break


def _cut(values: np.ndarray, begin: int, end: int) -> bool:
    level = values[begin]
    beside = [abs(values[i] - level) for i in (begin - 1, end) if 0 <= i < values.size]
    steps = np.diff(np.unique(values))
    # Equal readings may differ in their last digit once a scale has been applied.
    smallest = steps[steps > 1e-9 * (values.max() - values.min())].min()
    # Noise of about one step makes three equal readings at the very top now and then, but not six.
    return bool(beside) and (
        min(beside) > 3.5 * smallest or (end - begin >= 6 and max(beside) > 1.5 * smallest)
    )


def _climb(samples: Samples, rate: np.ndarray, step: np.ndarray) -> np.ndarray:
    begin, owner = samples.start[:-1], samples.owner
    # In units of what each recording could reach at most, so that an absurd one can't drown the others.
    unit = np.maximum.reduceat(np.abs(rate), begin) * np.add.reduceat(step, begin)
    unit = np.where(unit > 0, unit, 1)
    trapezoids = 0.5 * (rate + np.append(rate[1:], 0)) * step / unit[owner]
    total = np.concatenate([[0], np.cumsum(trapezoids)])[:-1]
    # Each recording is moved below all earlier ones, so that the running minimum starts anew with it.
    total -= total[begin][owner] + 4 * owner
    return np.maximum.reduceat(total - np.minimum.accumulate(total), begin) * unit


def _rest(samples: Samples, values: np.ndarray) -> np.ndarray:
    # Of a recording's two ends, the level of the one nearer to zero: an offset, or less than one.
    begin, end, few = samples.start[:-1], samples.start[1:], np.maximum(samples.count // 50, 3)
    total = np.concatenate([[0], np.cumsum(values)])
    first = (total[begin + few] - total[begin]) / few
    last = (total[end] - total[end - few]) / few
    return np.where(np.abs(first) < np.abs(last), first, last)


def _first_at(where: np.ndarray, begin: np.ndarray) -> np.ndarray:
    index = np.where(where, np.arange(where.size), where.size)
    return np.minimum.reduceat(index, begin)
