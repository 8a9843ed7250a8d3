"""The stretch of a recording that is read: `signal.crop` for all impacts, or two columns of `impacts.csv`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

from bayestissue.dataset.recordings import Samples, in_seconds
from bayestissue.dataset.settings import SignalSettings
from bayestissue.errors import Problem

COLUMNS = ("crop_start_s", "crop_stop_s")


@dataclass(frozen=True, eq=False)
class Windows:
    """The times between which each impact is read, both included, on the recorder's clock.

    Attributes:
        start: s; minus infinity where the recording is read from its beginning.
        stop: s; infinity where it is read to its end.
    """

    start: Float64[np.ndarray, " impact"]
    stop: Float64[np.ndarray, " impact"]

    @classmethod
    def stated(cls, impacts: pd.DataFrame, signal: SignalSettings) -> Windows:
        """What ``impacts.csv`` says; where a cell is empty, what ``signal.crop`` says."""
        general = in_seconds(np.array(signal.crop or [-np.inf, np.inf]), signal)
        ends = [
            np.where(np.isfinite(cell), cell, end)
            for cell, end in zip((_column(impacts, name) for name in COLUMNS), general, strict=True)
        ]
        return cls(*ends)

    def inside(self, which: int, time: Float64[np.ndarray, " sample"]) -> Bool[np.ndarray, " sample"] | slice:
        """The samples of impact ``which``; one whose time is no number stays, to be found as such."""
        start, stop = self.start[which], self.stop[which]
        if np.isinf(start) and np.isinf(stop):
            return slice(None)
        return ~((time < start) | (time > stop))

    def meet(self, first: int, second: int) -> bool:
        """Whether two impacts of one recording have a stretch in common."""
        return bool(self.start[first] < self.stop[second] and self.start[second] < self.stop[first])

    def nothing(self, which: int, time: np.ndarray, file: str, impact: str) -> Problem:
        """What is wrong where no sample lies inside."""
        start, stop = self.start[which], self.stop[which]
        return Problem(
            file,
            f"samples between {start:.6g} and {stop:.6g} s, to which the recording is cropped",
            f"Correct signal.crop in dataset.toml, or {' and '.join(COLUMNS)} in impacts.csv.",
            value=f"times from {time.min():.6g} to {time.max():.6g} s" if time.size else "no samples",
            impact=impact or None,
            code="crop",
        )


def crop(samples: Samples, windows: Windows, names: list[str]) -> tuple[Samples, list[Problem]]:
    """The samples inside the windows, and what is wrong with impacts that have none there.

    Args:
        samples: of the impacts that have any.
        windows: of all impacts.
        names: of all impacts.
    """
    bounds = list(zip(samples.impact, samples.start[:-1], samples.start[1:], strict=True))
    keep = np.zeros(samples.time.size, dtype=bool)
    for impact, begin, end in bounds:
        mine = keep[begin:end]
        mine[windows.inside(impact, samples.time[begin:end])] = True
    if keep.all():
        return samples, []
    count = np.array([np.count_nonzero(keep[begin:end]) for _, begin, end in bounds])
    problems = [
        windows.nothing(impact, samples.time[begin:end], file, names[impact])
        for (impact, begin, end), file, left in zip(bounds, samples.file, count, strict=True)
        if not left
    ]
    position = np.cumsum(keep) - 1
    return replace(
        samples,
        time=samples.time[keep],
        value=samples.value[keep],
        row=samples.row[keep],
        start=np.concatenate([[0], np.cumsum(count[count > 0])]),
        impact=samples.impact[count > 0],
        file=[file for file, left in zip(samples.file, count, strict=True) if left],
        text={int(position[at]): text for at, text in samples.text.items() if keep[at]},
    ), problems


def _column(impacts: pd.DataFrame, name: str) -> np.ndarray:
    if name not in impacts:
        return np.full(len(impacts), np.nan)
    return np.asarray(impacts[name], dtype=np.float64)
