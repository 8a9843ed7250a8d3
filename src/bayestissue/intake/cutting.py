"""Several impacts in one recording, cut apart where it is quiet for long enough between them."""

from __future__ import annotations

import numpy as np

from bayestissue.signal.traces import Trace, noise_sd, stack

THRESHOLD, SEPARATION_S = 20.0, 0.5
# Of the greatest peak: the handling of the impactor between two impacts stays below it.
_SHARE = 0.1
# Of the separation, before and after an impact: enough rest to learn the noise and the zero from.
_BEFORE, _AFTER = 0.1, 0.5
_FEWEST = 8
# Nanoseconds: no recorder's clock is read finer.
_DIGITS = 9


def cut(
    trace: Trace, *, threshold: float = THRESHOLD, separation_s: float = SEPARATION_S
) -> list[tuple[float, float]]:
    """When each impact of a recording begins and ends, in order, s on the recorder's clock.

    Samples that rise above the median by more than ``threshold`` standard deviations of the noise, and by
    more than a tenth of the highest, belong to impacts. Two of them that lie at least ``separation_s`` apart
    belong to two impacts. An impact is cut out from a tenth of that time before its first such sample to half
    of it after its last one, so that no two stretches meet. The noise is the greater of the white noise that
    third differences show and the scatter about the median (the median absolute deviation over 0.6745).

    Args:
        trace: positive while the impactor slows, or into the tissue.
        threshold: in standard deviations of the noise.
        separation_s: the least time between two impacts; a rebound that follows sooner stays with its impact.

    Returns:
        One stretch for each impact; none where nothing rises above the noise.
    """
    value, time = trace.value, trace.time_s
    if value.size < _FEWEST or not (np.isfinite(value).all() and np.isfinite(time).all()):
        return []
    above = value - np.median(value)
    noise = max(float(noise_sd(stack([trace]))[0]), float(np.median(np.abs(above))) / 0.6745)
    moments = time[above > max(threshold * noise, _SHARE * above.max())]
    if not moments.size:
        return []
    gap = np.flatnonzero(np.diff(moments) >= separation_s)
    starts, ends = np.append(moments[:1], moments[gap + 1]), np.append(moments[gap], moments[-1:])
    return list(
        zip(
            (starts - _BEFORE * separation_s).round(_DIGITS).tolist(),
            (ends + _AFTER * separation_s).round(_DIGITS).tolist(),
            strict=True,
        )
    )
