"""All recordings of a dataset end to end in one array, cropped, with what `impacts.csv` says of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64, Int, Int8, Shaped

from bayestissue.dataset.settings import LowPassFilter, Quantity, SignalSettings, Uncertainty
from bayestissue.dataset.units import to_si
from bayestissue.errors import Problem

# The columns of `impacts.csv` that state a stretch, and the fewest samples that are a recording.
CROP = ("crop_start_s", "crop_stop_s")
MIN_SAMPLES = 8
# Of a step: times that stray by no more from even ones are taken as even, as a clock of few digits has them.
EVEN_WITHIN = 0.1
# Of a stated sampling rate, by which that of the times may differ.
RATE_WITHIN = 0.01
# A clock that has rounded its times has one of so many decimals of a second.
_DECIMALS = range(2, 6)


def uneven(
    time: Float64[np.ndarray, " sample"], start: Int[np.ndarray, " impact+1"]
) -> Bool[np.ndarray, " impact"]:
    """Which recordings, end to end, have a sample farther than `EVEN_WITHIN` of a step from even times.

    Even times that a clock of few decimals has rounded are even.

    Args:
        time: of all samples, s.
        start: where each recording begins, and last where they all end.
    """
    begin, count = start[:-1], np.diff(start)
    step = (time[start[1:] - 1] - time[begin]) / np.maximum(count - 1, 1)
    even = np.repeat(time[begin], count) + np.repeat(step, count) * (
        np.arange(time.size) - np.repeat(begin, count)
    )
    stray = np.maximum.reduceat(np.abs(time - even), begin)
    is_uneven = ~(stray <= EVEN_WITHIN * step)
    for which in np.flatnonzero(is_uneven):
        is_uneven[which] = not _rounded(time[start[which] : start[which + 1]], step[which])
    return is_uneven


def _rounded(time: Float64[np.ndarray, " sample"], step: float) -> bool:
    """Whether these are even times to the decimals that they have, half of the last off at the most.

    With a last decimal as large as the step itself a lost sample would look the same.
    """
    index = np.arange(time.size)
    left = time - np.polynomial.Polynomial.fit(index, time, 1)(index)
    for decimals in _DECIMALS:
        last = 10.0**-decimals
        ticks = time / last
        if (np.abs(ticks - np.rint(ticks)) < 1e-6 * np.maximum(np.abs(ticks), 1.0)).all():
            return bool(np.ptp(left) < 1.1 * last < 0.45 * step)
    return False


def interpolated(
    time: Float64[np.ndarray, " sample"],
    owner: Int[np.ndarray, " sample"],
    other_time: Float64[np.ndarray, " other"],
    other_value: Float64[np.ndarray, " other"],
    other_owner: Int[np.ndarray, " other"],
) -> Float64[np.ndarray, " sample"]:
    """Values of other recordings at these times, between their samples in proportion, of all impacts at once.

    Beyond the ends of a recording they are its last value or, far beyond, another one's.

    Args:
        time: s.
        owner: which recording each is to be taken of.
        other_time: of the other samples, s, rising in each recording.
        other_value: of the other samples.
        other_owner: which recording each is of, in order.
    """
    # End to end on one axis of time.
    least = min(time.min(), other_time.min())
    width = 2 * (max(time.max(), other_time.max()) - least) + 1.0
    return np.interp(time - least + width * owner, other_time - least + width * other_owner, other_value)


@dataclass(frozen=True, eq=False)
class Samples:
    """The recordings of all impacts that have one, end to end, in SI units.

    Attributes:
        time: s.
        value: m/s² or m, after scale and offset; nan where the file held no number.
        start: where each impact's samples begin, and last where they all end.
        impact: for each of them its position in ``impacts.csv``.
        file: for each of them the file it came from.
        row: for every sample its row there.
        time_column, value_column: what the columns are called there.
        text: what stood in cells that held no number, by the index of the sample.
        clipped: 1 where a sample stands at the sensor's upper limit, -1 at its lower one, else 0; None where
            none does.
    """

    time: Float64[np.ndarray, " sample"]
    value: Float64[np.ndarray, " sample"]
    start: Int[np.ndarray, " impact+1"]
    impact: Int[np.ndarray, " impact"]
    file: list[str]
    row: Int[np.ndarray, " sample"]
    time_column: str = "time_s"
    value_column: str = "value"
    text: dict[int, str] = field(default_factory=dict)
    clipped: Int8[np.ndarray, " sample"] | None = None

    @classmethod
    def joined(cls, parts: Sequence[Samples], signal: SignalSettings) -> Samples:
        """Those of several impacts, each by itself, end to end."""
        start = np.cumsum([0, *(part.time.size for part in parts)])
        return cls(
            np.concatenate([np.empty(0), *(part.time for part in parts)]),
            np.concatenate([np.empty(0), *(part.value for part in parts)]),
            start,
            np.array([part.impact[0] for part in parts], dtype=int),
            [part.file[0] for part in parts],
            np.concatenate([np.empty(0, int), *(part.row for part in parts)]),
            signal.time_column,
            signal.value_column,
            {
                int(at) + i: words
                for at, part in zip(start, parts, strict=False)
                for i, words in part.text.items()
            },
        )

    @property
    def count(self) -> np.ndarray:
        """How many samples each impact has."""
        return np.diff(self.start)

    @property
    def begin(self) -> np.ndarray:
        """The first sample of each impact."""
        return self.start[:-1]

    @property
    def end(self) -> np.ndarray:
        """The one after the last sample of each impact."""
        return self.start[1:]

    @property
    def duration(self) -> np.ndarray:
        """From the first to the last sample of each impact, s."""
        return self.time[self.end - 1] - self.time[self.begin]

    @property
    def interval(self) -> np.ndarray:
        """The mean sampling interval of each impact, s."""
        return self.duration / (self.count - 1)

    @property
    def limited(self) -> np.ndarray:
        """Which recordings have a sample at the sensor's limit."""
        if self.clipped is None:
            return np.zeros(self.impact.size, bool)
        return np.logical_or.reduceat(self.clipped != 0, self.begin)

    @property
    def lost(self) -> np.ndarray:
        """How many samples are missing in longer steps of the recordings whose times are `uneven`, else 0."""
        # Not whole numbers: steps of damaged times are greater than those can be.
        missing = np.zeros(self.impact.size)
        for which in np.flatnonzero(uneven(self.time, self.start)):
            steps = np.diff(self.time[self.begin[which] : self.end[which]])
            with np.errstate(all="ignore"):
                missing[which] = (np.rint(steps / np.median(steps)) - 1).clip(0).sum()
        return missing

    @property
    def owner(self) -> np.ndarray:
        """For every sample which of the recordings it belongs to."""
        return np.repeat(np.arange(self.impact.size), self.count)

    @property
    def to_their_ends(self) -> Samples:
        """Without rows behind the end of a recording, in which others of the table go on: they are empty."""
        filled = np.isfinite(self.time) | np.isfinite(self.value)
        filled[[at for at, words in self.text.items() if words.strip()]] = True
        if filled.all():
            return self
        at = np.arange(filled.size)
        last = np.maximum.reduceat(np.where(filled, at, -1), self.begin)[self.owner]
        return self.at((at <= last) | (last < 0))

    def only(self, keep: np.ndarray) -> Samples:
        """The recordings for which ``keep`` (one truth value each) holds."""
        if keep.all():
            return self
        return self.at(np.repeat(keep, self.count))

    def at(self, keep: Bool[np.ndarray, " sample"]) -> Samples:
        """The samples for which ``keep`` holds, of the recordings that have any of them."""
        position = np.cumsum(keep) - 1
        count = np.diff(np.concatenate([[0], position + 1])[self.start])
        return replace(
            self,
            time=self.time[keep],
            value=self.value[keep],
            row=self.row[keep],
            clipped=None if self.clipped is None else self.clipped[keep],
            start=np.concatenate([[0], np.cumsum(count[count > 0])]),
            impact=self.impact[count > 0],
            file=[file for file, left in zip(self.file, count, strict=True) if left],
            text={int(position[at]): text for at, text in self.text.items() if keep[at]},
        )


@dataclass(frozen=True, eq=False)
class Reading:
    """What came of reading the recordings.

    Attributes:
        samples: of the impacts that have any.
        problems: what is wrong with single impacts.
        files: what was read.
    """

    samples: Samples
    problems: list[Problem]
    files: list[Path]


def in_si(raw: np.ndarray, signal: SignalSettings) -> np.ndarray:
    """Raw values in m/s² or m: scale and offset first, then the unit, then the sensor's zero.

    What a sensor reads whose zero is at rest becomes force over mass: see `bayestissue.dataset.Dataset`.
    """
    # What overflows is found with everything else that is not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        value = (raw * signal.scale + signal.offset) * to_si(signal.unit, signal.dimension)
        return value + signal.below_force if signal.below_force else value


def in_seconds(time: np.ndarray, signal: SignalSettings) -> np.ndarray:
    """Times in s."""
    with np.errstate(over="ignore", invalid="ignore"):
        return time * to_si(signal.time_unit, "time")


def ends_of(signal: SignalSettings) -> tuple[float, float]:
    """The times from which and to which recordings are read, s, by ``signal.crop``."""
    start, stop = in_seconds(np.array(signal.crop or [-np.inf, np.inf]), signal)
    return float(start), float(stop)


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
        cells = (_column(impacts, name) for name in CROP)
        ends = zip(cells, ends_of(signal), strict=True)
        return cls(*(np.where(np.isfinite(cell), cell, end) for cell, end in ends))

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
        ends = {"start": self.start[which], "stop": self.stop[which]}
        times = f"times from {time.min():.6g} to {time.max():.6g} s" if time.size else "no samples"
        return Problem.stated("crop.nothing", file, value=times, impact=impact, **ends)


def crop(samples: Samples, windows: Windows, names: list[str]) -> tuple[Samples, list[Problem]]:
    """The samples inside the windows, and what is wrong with impacts that have none there.

    Args:
        samples: of the impacts that have any.
        windows: of all impacts.
        names: of all impacts.
    """
    keep, problems = np.zeros(samples.time.size, dtype=bool), []
    bounds = zip(samples.impact, samples.file, samples.start[:-1], samples.start[1:], strict=True)
    for impact, file, begin, end in bounds:
        time = samples.time[begin:end]
        keep[begin:end][windows.inside(impact, time)] = True
        if not keep[begin:end].any():
            problems.append(windows.nothing(impact, time, file, names[impact]))
    return (samples, []) if keep.all() else (samples.at(keep), problems)


def _column(impacts: pd.DataFrame, name: str) -> np.ndarray:
    if name not in impacts:
        return np.full(len(impacts), np.nan)
    return np.asarray(impacts[name], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Recordings:
    """The samples of every impact that has any, and what else the checks need to know.

    Attributes:
        samples: end to end.
        name: of each impact.
        velocity: at contact, m/s; nan where it is not known.
        rate: the sampling rate that ``impacts.csv`` states, Hz; nan where it states none.
        quantity: what was recorded.
        uncertainty: of the measuring chain.
        gravity: along the motion, m/s².
        recorder: a low-pass that is declared, or None.
    """

    samples: Samples
    name: Shaped[np.ndarray, " impact"]
    velocity: Float64[np.ndarray, " impact"]
    rate: Float64[np.ndarray, " impact"]
    quantity: Quantity
    uncertainty: Uncertainty
    gravity: float = 0.0
    recorder: LowPassFilter | None = None

    @classmethod
    def with_impacts(
        cls,
        samples: Samples,
        impacts: pd.DataFrame,
        quantity: Quantity,
        uncertainty: Uncertainty,
        **chain: Any,
    ) -> Recordings:
        """The samples with the rows of ``impacts`` beside them; ``chain`` has the last two attributes."""
        rows = impacts.iloc[samples.impact]
        rate = _column(rows, "sampling_rate_hz")
        of_impacts = rows["impact"].to_numpy(), rows["velocity_m_s"].to_numpy(), rate
        return cls(samples, *of_impacts, quantity, uncertainty, **chain)

    def without(self, problems: list[Problem]) -> Recordings:
        """The recordings of impacts that none of the problems concerns."""
        return self._only(~self._among(problem.impact for problem in problems))

    def of_impacts(self, names: Iterable[str]) -> Recordings:
        """The recordings of these impacts."""
        return self._only(self._among(names))

    def _among(self, names: Iterable[str | None]) -> Bool[np.ndarray, " impact"]:
        wanted = set(names)
        return np.array([name in wanted for name in self.name], dtype=bool)

    def _only(self, keep: Bool[np.ndarray, " impact"]) -> Recordings:
        return replace(
            self,
            samples=self.samples.only(keep),
            name=self.name[keep],
            velocity=self.velocity[keep],
            rate=self.rate[keep],
        )

    def problem(
        self,
        key: str,
        which: int | np.integer,
        value: object,
        *,
        at: int | np.integer | None = None,
        column: str | None = None,
        **numbers: Any,
    ) -> Problem:
        """What is wrong with recording ``which``, at the sample ``at`` if it is one sample's fault.

        Args:
            key: of the message: see `Problem.stated`.
            which: recording.
            value: what was found.
            at: which sample.
            column: that of the values unless another is named.
            numbers: in the message.
        """
        file, name = self.samples.file[which], str(self.name[which])
        row = None if at is None else int(self.samples.row[at])
        column = column or self.samples.value_column
        return Problem.stated(key, file, row, column, value, impact=name, **numbers)

    def where(
        self,
        wrong: Bool[np.ndarray, " impact"],
        key: str,
        words: str,
        values: Shaped[np.ndarray, " impact"],
        *,
        column: str | None = None,
        **numbers: Any,
    ) -> Iterator[Problem]:
        """A problem for each recording that is ``wrong``; arguments as of `problem`.

        Args:
            wrong: which recordings are.
            key: of the message.
            words: what is there instead, with braces for the number.
            values: that number of each recording.
            column: that of the values unless another is named.
            numbers: in the message; an array has one of each recording.
        """
        for which in np.flatnonzero(wrong):
            here = {name: n[which] if isinstance(n, np.ndarray) else n for name, n in numbers.items()}
            yield self.problem(key, which, words.format(values[which]), column=column, **here)
