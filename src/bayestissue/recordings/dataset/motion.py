"""How far and which way each recording goes: enough to tell a wrong sign, unit or length of recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayestissue.recordings.dataset.dataset_file import Quantity
from bayestissue.recordings.dataset.plausible import PLAUSIBLE
from bayestissue.recordings.dataset.ragged_traces import IntPerImpact, PerImpact, Traces


@dataclass(frozen=True, eq=False)
class Motion:
    """How far, how fast and which way each recording goes, in SI units.

    Attributes:
        low, high: the least and greatest recorded value.
        peak: where the greatest displacement stands, or the greatest deceleration.
        extreme: the value farthest from the first one on the side to which the recording first goes, less
            that first one. An impactor that has left the tissue may go farther than it came in.
        pulse: how many samples exceed a tenth of the greatest deceleration; all, for displacements.
        duration: of those samples, s.
        rise: from a tenth of the greatest deceleration, the last time before it, to the greatest, s; 0 for
            displacements.
        loss, gain: the greatest speed lost (gained) between any two moments, m/s; 0 for displacements.
        pulse_loss: as ``loss``, but after taking off what the recording shows at its quieter end, so that
            an offset over a long recording counts for little.
        step_loss: the speed lost in one interval at the greatest deceleration, m/s.
    """

    low: PerImpact
    high: PerImpact
    peak: IntPerImpact
    extreme: PerImpact
    pulse: IntPerImpact
    duration: PerImpact
    rise: PerImpact
    loss: PerImpact
    gain: PerImpact
    pulse_loss: PerImpact
    step_loss: PerImpact

    @property
    def farthest(self) -> PerImpact:
        """The value farthest from 0, on either side."""
        return np.maximum(np.abs(self.high), np.abs(self.low))


def motion(traces: Traces, quantity: Quantity, gravity: float = 0.0) -> Motion:
    """The figures of `Motion` for every recording.

    Args:
        traces: finite, at least two per recording, times rising.
        quantity: what was recorded.
        gravity: along the motion, m/s²: force over mass slows by so much less.
    """
    begin, end, owner = traces.begin, traces.end, traces.owner
    slowing = traces.slowing(quantity).value
    greatest = np.maximum.reduceat(slowing, begin)
    displaced = traces.value - traces.value[begin][owner]
    begins = _first_at(
        np.abs(displaced) >= PLAUSIBLE.begins * np.maximum.reduceat(np.abs(displaced), begin)[owner], begin
    )
    side = np.where(displaced[begins] < 0, -1.0, 1.0)
    interval = traces.interval
    peak = _first_at(slowing == greatest[owner], begin)
    loss = gain = pulse_loss = rise = np.zeros(begin.size)
    pulse = traces.n_samples
    if quantity != "displacement":
        above, position = slowing > PLAUSIBLE.pulse * greatest[owner], np.arange(owner.size)
        pulse = np.add.reduceat(above.astype(int), begin)
        below = np.where(~above & (position < peak[owner]), position, begin[owner])
        rise = traces.time_s[peak] - traces.time_s[np.maximum.reduceat(below, begin)]
        # An offset can't add up to much over a recording that is hardly longer than the impact.
        baseline = np.where(2 * pulse < traces.n_samples, _rest(traces, slowing), 0)
        step = np.append(np.diff(traces.time_s), 0)
        # The step from one recording to the next means nothing.
        step[end - 1] = 0
        loss = _climb(traces, slowing - gravity, step)
        gain = _climb(traces, np.minimum(baseline, 0)[owner] - slowing, step)
        pulse_loss = _climb(traces, slowing - np.maximum(baseline, 0)[owner] - gravity, step)
    return Motion(
        low=np.minimum.reduceat(traces.value, begin),
        high=np.maximum.reduceat(traces.value, begin),
        peak=peak,
        extreme=side * np.maximum.reduceat(side[owner] * displaced, begin),
        pulse=pulse,
        duration=pulse * interval,
        rise=rise,
        loss=loss,
        gain=gain,
        pulse_loss=pulse_loss,
        step_loss=np.maximum(greatest, 0) * interval,
    )


def _climb(traces: Traces, rate: np.ndarray, step: np.ndarray) -> np.ndarray:
    begin, owner = traces.begin, traces.owner
    # In units of what each recording could reach at most, so that an absurd one can't drown the others.
    unit = np.maximum.reduceat(np.abs(rate), begin) * np.add.reduceat(step, begin)
    unit = np.where(unit > 0, unit, 1)
    trapezoids = 0.5 * (rate + np.append(rate[1:], 0)) * step / unit[owner]
    total = np.concatenate([[0], np.cumsum(trapezoids)])[:-1]
    # Each recording is moved below all earlier ones, so that the running minimum starts anew with it.
    total -= total[begin][owner] + 4 * owner
    return np.maximum.reduceat(total - np.minimum.accumulate(total), begin) * unit


def _rest(traces: Traces, values: np.ndarray) -> np.ndarray:
    # Of a recording's two ends, the level of the one nearer to zero: an offset, or less than one.
    begin, end = traces.begin, traces.end
    few = np.minimum(np.maximum(traces.n_samples // 50, 3), traces.n_samples)
    total = np.concatenate([[0], np.cumsum(values)])
    first = (total[begin + few] - total[begin]) / few
    last = (total[end] - total[end - few]) / few
    return np.where(np.abs(first) < np.abs(last), first, last)


def _first_at(where: np.ndarray, begin: np.ndarray) -> np.ndarray:
    index = np.where(where, np.arange(where.size), where.size)
    return np.minimum.reduceat(index, begin)
