"""Recordings that stand twice: copied, or exported anew with other digits, another beginning, gain or rate.

Noise never repeats itself. Of two impacts, however alike, the samples differ by the noise of both, σ √2 in
standard deviation; of one recording that was exported twice, by rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from bayestissue.base.errors import Problem
from bayestissue.recordings.dataset.ragged_traces import RATE_WITHIN, Traces
from bayestissue.recordings.dataset.recordings import Recordings


@dataclass(frozen=True)
class TwinSettings:
    """By what two recordings are one.

    Attributes:
        near: of the noise: with 16 samples or more, two impacts come nearer than this less than once in 10¹⁰
            pairs.
        window: samples behind a landmark that are compared first.
        shifts: in samples: how far the landmarks of two may differ.
        steep: the samples over which a recording is steepest.
        gain: that two exports may differ by.
        arithmetic: of the peak: what arithmetic leaves of a recording that is scaled and scaled back.
        kept: one sample of so many at the least, where an export left out others.
    """

    near: float = 0.5
    window: int = 16
    shifts: tuple[int, ...] = (-1, 0, 1)
    steep: int = 8
    gain: float = 0.01
    arithmetic: float = 1e-9
    kept: int = 20


TWINS = TwinSettings()


def recording_twice(recordings: Recordings) -> Iterator[Problem]:
    """Recordings of an earlier impact again: see `twins`.

    As two impacts such a recording makes K and C of that person seem known better than they are, and wrong
    where the stated mass or velocity differs.
    """
    for which, earlier, exact in twins(recordings):
        how = (
            "the same samples as" if exact else "with other digits, beginning, gain or rate, the recording of"
        )
        yield recordings.problem("recording-twice", which, f"{how} impact {recordings.name[earlier]}")


def twins(traces: Traces) -> Iterator[tuple[int, int, bool]]:
    """Of each recording that stands twice its place, that of the first one, and whether all digits agree.

    A recording is another one again where, laid upon each other at their highest or steepest samples, give
    or take one, and with the gain and offset of a straight line between them, the two differ by less than
    half of the noise. The gain is 1 within 1 %. The noise is white noise, by fifth differences, the smaller
    one of the two: noise that is smooth from sample to sample makes it too small, and hides rather than
    raises an alarm. Of recordings whose intervals are multiples of one another, those of the shorter one are
    looked at with as many samples left out, from each of the first ones on.
    """
    values = [trace.value for trace in traces]
    first: dict[bytes, int] = {}
    distinct = []
    for which, value in enumerate(values):
        earlier = first.setdefault(value.tobytes(), which)
        if earlier == which:
            distinct.append(which)
        else:
            yield which, earlier, True
    yield from _again([(which, values[which]) for which in distinct], values)
    rates = np.round(np.log(traces.interval[distinct]) / np.log1p(RATE_WITHIN)).astype(int)
    groups = [[distinct[at] for at in np.flatnonzero(rates == rate)] for rate in np.unique(rates)]
    for fine, coarse in combinations(groups, 2):
        ratio = traces.interval[coarse[0]] / traces.interval[fine[0]]
        if 2 <= (factor := round(ratio)) <= TWINS.kept and abs(ratio / factor - 1) < 2 * RATE_WITHIN:
            thinned = [(which, values[which][begin::factor]) for which in fine for begin in range(factor)]
            yield from _again([*thinned, *((which, values[which]) for which in coarse)], values)


def _again(rows: list[tuple[int, np.ndarray]], whole: list[np.ndarray]) -> Iterator[tuple[int, int, bool]]:
    """The twins among recordings, by their places and samples; their noise is that of the ``whole`` ones."""
    rows = [(which, value) for which, value in rows if value.size > 2 * TWINS.window and np.ptp(value) > 0]
    rows = [(which, value) for which, value in rows if np.isfinite(np.square(value).sum())]
    if len(rows) < 2:
        return
    places, values = zip(*rows, strict=True)
    noise = np.array([_noise(whole[which]) for which in places])
    height = np.array([np.ptp(value) for value in values])
    first: dict[int, int] = {}
    window, steep = TWINS.window, TWINS.steep
    heights = (np.abs(value[1:-window] - value.mean()) for value in values)
    rises = (np.abs(value[1 + steep : steep - window] - value[1:-window]) for value in values)
    for sizes in (heights, rises):
        at = np.array([1 + int(np.argmax(size)) for size in sizes])
        for one, other, lag in _alike(values, at, TWINS.near * noise + TWINS.arithmetic * height):
            limit = TWINS.near * min(noise[one], noise[other]) + TWINS.arithmetic * height[one]
            if places[one] != places[other] and _differ(values[one], values[other], lag) < limit:
                earlier, later = sorted((places[one], places[other]))
                first[later] = min(earlier, first.get(later, earlier))
    yield from ((later, first[later], False) for later in sorted(first))


def _alike(values: Sequence[np.ndarray], at: np.ndarray, near: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Pairs that are alike behind a landmark, the later first, and by how many samples it lies behind."""
    from scipy.spatial import KDTree

    def behind(shift: int) -> tuple[np.ndarray, np.ndarray]:
        windows = np.array(
            [value[i + shift : i + shift + TWINS.window] for value, i in zip(values, at, strict=True)]
        )
        windows -= windows.mean(axis=1, keepdims=True)
        length = np.maximum(np.linalg.norm(windows, axis=1), np.finfo(float).tiny)
        return windows / length[:, None], length

    # Of length 1 each: a copy may have another offset and gain.
    tree = KDTree(behind(0)[0])
    for shift in TWINS.shifts:
        directions, length = behind(shift)
        reach = np.minimum(near * np.sqrt(TWINS.window) / length, TWINS.near)
        for later, others in enumerate(tree.query_ball_point(directions, reach)):
            for earlier in others:
                if earlier < later:
                    yield later, earlier, int(at[later] + shift - at[earlier])


def _noise(value: np.ndarray) -> float:
    # Fifth differences of a smooth signal are small; of white noise they have the sd √252 σ.
    return float(np.median(np.abs(np.diff(value, 5)))) / (ndtri(0.75) * np.sqrt(252.0))


def _differ(first: np.ndarray, second: np.ndarray, lag: int) -> float:
    """The root mean square of what a line in ``second``, ``lag`` samples before, leaves of ``first``."""
    begin, end = max(0, lag), min(first.size, second.size + lag)
    if 2 * (end - begin) < min(first.size, second.size):
        return np.inf
    x, y = second[begin - lag : end - lag], first[begin:end]
    x, y = x - x.mean(), y - y.mean()
    gain = float(x @ y) / float(x @ x) if x.any() else 0.0
    return float(np.sqrt(np.mean((y - gain * x) ** 2))) if abs(gain - 1) < TWINS.gain else np.inf
