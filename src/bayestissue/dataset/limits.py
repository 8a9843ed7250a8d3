"""Which samples stand at the sensor's limit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int8

from bayestissue.dataset.recordings import Samples
from bayestissue.dataset.settings import ChannelQuantity, Quantity
from bayestissue.dataset.tables import BEYOND_LIMIT


@dataclass(frozen=True)
class LimitSettings:
    """By what samples at a sensor's limit are told from the peak of an impact.

    Attributes:
        plateau: so many equal greatest values make a plateau of one recording, if hardly any stand just
            below.
        recordings: a limit is the greatest value of so many recordings,
        samples: or of two with more than so many such samples together.
        steps_below: within so many steps of the recorder below a limit hardly any recording has its greatest
            value.
        same: of the values' size: equal readings may differ in their last digit once a scale was applied.
    """

    plateau: int = 4
    recordings: int = 3
    samples: int = 3
    steps_below: float = 4.5
    same: float = 1e-9


LIMITS = LimitSettings()


def with_limits(
    samples: Samples, quantity: Quantity | ChannelQuantity, stated: tuple[float, float] | None = None
) -> Samples:
    """The recordings with what `at_limit` finds, and what a recorder itself wrote as beyond its range.

    That has the greatest value of the recording on its side, or the one that was stated; arguments as of
    `at_limit`.
    """
    said = [at for at, words in samples.text.items() if words.strip() in BEYOND_LIMIT]
    at = np.array([i for i in said if np.isinf(samples.value[i])], int)
    clipped = at_limit(samples, quantity, stated)
    if not at.size:
        return replace(samples, clipped=clipped) if clipped.any() else samples
    value = samples.value.copy()
    for sign in (1, -1):
        limits = np.maximum.reduceat(np.where(np.isfinite(value), sign * value, -np.inf), samples.begin)
        if stated is not None:
            limits = np.maximum(limits, sign * stated[sign > 0])
        mine = at[np.sign(samples.value[at]) == sign]
        value[mine] = sign * limits[samples.owner[mine]]
    clipped[at] = np.sign(samples.value[at])
    return replace(samples, value=value, clipped=clipped)


def at_limit(
    samples: Samples, quantity: Quantity | ChannelQuantity, stated: tuple[float, float] | None = None
) -> Int8[np.ndarray, " sample"]:
    """1 where a sample stands at the sensor's upper limit, -1 at its lower one, 0 elsewhere.

    A limit is what was stated; else the greatest value of several recordings, if hardly any recording has its
    own just below it, or a plateau in one of them. No recording of the sensor goes beyond it.

    Args:
        samples: the recordings, of one sensor.
        quantity: what was recorded.
        stated: the lower and the upper limit, m/s², m or N; None where none is known.
    """
    value, clipped = samples.value, np.zeros(samples.value.size, np.int8)
    if not samples.impact.size:
        return clipped
    with np.errstate(all="ignore"):
        if stated is not None:
            low, high = (
                limit * (1 - np.copysign(LIMITS.same, limit * side))
                for limit, side in zip(stated, (-1, 1), strict=True)
            )
            return (value >= high).astype(np.int8) - (value <= low).astype(np.int8)
        for sign in (1, -1):
            limit = _shared(samples, sign)
            if limit is not None:
                clipped[np.abs(value - limit) <= LIMITS.same * np.abs(limit)] = sign
        _mark_plateaus(samples, quantity, clipped)
    return clipped


def _shared(samples: Samples, sign: int) -> float | None:
    """The greatest value of the recordings on one side, if it is a limit of several."""
    value = sign * samples.value
    greatest = np.maximum.reduceat(value, samples.begin)
    least = np.minimum.reduceat(value, samples.begin)
    known = np.isfinite(greatest) & (greatest > 0.5 * -least) & (greatest > least)
    if known.sum() < 2:
        return None
    limit = greatest[known].max()
    same = known & (greatest >= limit * (1 - LIMITS.same))
    # What was exported twice has its greatest value twice.
    parts = [value[samples.begin[which] : samples.end[which]] for which in np.flatnonzero(same)]
    different = len({part.tobytes() for part in parts})
    count = sum(np.count_nonzero(part >= limit * (1 - LIMITS.same)) for part in parts)
    step = _step(value[np.isfinite(value)], LIMITS.same * limit, otherwise=limit)
    below = np.count_nonzero(known & ~same & (greatest > limit - LIMITS.steps_below * step))
    several = different >= LIMITS.recordings or (different == 2 and count > LIMITS.samples)
    return float(sign * limit) if several and different > 3 * below else None


def _mark_plateaus(
    samples: Samples, quantity: Quantity | ChannelQuantity, clipped: Int8[np.ndarray, " sample"]
) -> None:
    """Write into ``clipped`` where recordings are cut off at one value.

    At a recorder's limit samples pile up: more stand there than the few steps of the recorder's scale below
    it hold together. A smooth or noisy peak has its readings spread over these steps. Of a displacement only
    the upper side counts.
    """
    value = samples.value
    ends = [np.maximum.reduceat(value, samples.begin), np.minimum.reduceat(value, samples.begin)]
    greatest = np.maximum(*np.abs(ends))
    for limit, sign in zip(ends[:1] if quantity == "displacement" else ends, (1, -1), strict=False):
        count = np.add.reduceat((value == limit[samples.owner]).astype(int), samples.begin)
        extreme = (np.abs(limit) > 0.5 * greatest) & (ends[0] > ends[1])
        for which in np.flatnonzero(extreme & (count >= LIMITS.plateau)):
            mine = value[samples.begin[which] : samples.end[which]]
            distance = np.abs(mine - limit[which])
            near = LIMITS.steps_below * _step(mine, LIMITS.same * np.ptp(mine))
            if count[which] > 3 * np.count_nonzero((distance > 0) & (distance < near)) + 2:
                clipped[samples.begin[which] : samples.end[which]][mine == limit[which]] = sign


def _step(values: Float64[np.ndarray, " sample"], rounding: float, otherwise: float = np.inf) -> float:
    """The recorder's step: the least difference of values that is more than ``rounding``."""
    steps = np.diff(np.unique(values))
    return float(steps[steps > rounding].min(initial=otherwise))
