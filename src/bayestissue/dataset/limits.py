"""Which samples stand at the sensor's limit."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int8

from bayestissue.dataset.chain import Quantity
from bayestissue.dataset.motion import flat_top, motion
from bayestissue.dataset.recordings import Samples

# So many equal greatest values make a plateau of one recording, if hardly any stands just below.
FLAT_SAMPLES = 4
# Of the values' range: equal readings may differ in their last digit once a scale has been applied.
_SAME = 1e-9
# A limit is the greatest value of so many recordings, or of two with so many such samples together.
_SHARED, _FEW_SHARED = 3, 3
# So many steps of the recorder below a limit hardly any recording has its greatest value.
_JUST_BELOW = 4.5


def at_limit(
    samples: Samples, quantity: Quantity, stated: tuple[float, float] | None = None
) -> Int8[np.ndarray, " sample"]:
    """1 where a sample stands at the sensor's upper limit, -1 at its lower one, 0 elsewhere.

    A limit is what was stated; else the greatest value of several recordings, if hardly any recording has its
    own just below it, or a plateau in one of them. No recording of the sensor goes beyond it.

    Args:
        samples: the recordings, of one sensor.
        quantity: what was recorded.
        stated: the lower and the upper limit, m/s² or m; None where none is known.
    """
    clipped = np.zeros(samples.value.size, np.int8)
    if not samples.impact.size:
        return clipped
    with np.errstate(invalid="ignore"):
        if stated is not None:
            low, high = (
                limit * (1 - np.copysign(_SAME, limit * side))
                for limit, side in zip(stated, (-1, 1), strict=True)
            )
            return (samples.value >= high).astype(np.int8) - (samples.value <= low).astype(np.int8)
        for sign in (1, -1):
            limit = _shared(samples, sign)
            if limit is not None:
                close = np.abs(samples.value - limit) <= _SAME * np.abs(limit)
                clipped[close] = sign
    whole = samples.only(np.logical_and.reduceat(np.isfinite(samples.value), samples.begin))
    if not whole.impact.size:
        return clipped
    names = {impact: which for which, impact in enumerate(samples.impact)}
    with np.errstate(all="ignore"):
        moving = motion(whole, quantity)
        for which, _, _, limit in flat_top(whole, moving, quantity, FLAT_SAMPLES):
            mine = names[whole.impact[which]]
            here = slice(samples.begin[mine], samples.end[mine])
            clipped[here][samples.value[here] == limit] = 1 if limit == moving.high[which] else -1
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
    same = known & (greatest >= limit - _SAME * limit)
    # What was exported twice has its greatest value twice.
    different = {value[samples.begin[w] : samples.end[w]].tobytes() for w in np.flatnonzero(same)}
    count = sum(
        int((value[samples.begin[w] : samples.end[w]] >= limit - _SAME * limit).sum())
        for w in np.flatnonzero(same)
    )
    steps = np.diff(np.unique(value[np.isfinite(value)]))
    step = steps[steps > _SAME * limit].min(initial=limit)
    below = int((known & ~same & (greatest > limit - _JUST_BELOW * step)).sum())
    several = len(different) >= _SHARED or (len(different) == 2 and count > _FEW_SHARED)
    return float(sign * limit) if several and len(different) > 3 * below else None
