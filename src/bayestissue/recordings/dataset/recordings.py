"""Recordings as they were read: the file and the row of each sample, cropping, and what is wrong with one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int, Shaped

from bayestissue.base.errors import Problem
from bayestissue.recordings.dataset.dataset_file import (
    ChannelQuantity,
    LowPassFilter,
    Quantity,
    SignalSettings,
    Uncertainty,
)
from bayestissue.recordings.dataset.motion import Motion, motion
from bayestissue.recordings.dataset.ragged_traces import (
    BoolPerImpact,
    IntPerImpact,
    PerImpact,
    Traces,
    at_limit,
)
from bayestissue.recordings.dataset.sample_tables import BEYOND_LIMIT
from bayestissue.recordings.dataset.units import to_si

# A place among recordings or samples, and something of each impact.
At = int | np.integer
OfEach = Shaped[np.ndarray, " impact"]
# The columns of `impacts.csv` that state a stretch.
CROP = ("crop_start_s", "crop_stop_s")


@dataclass(frozen=True, eq=False)
class Samples(Traces):
    """The recordings of all impacts that have one, as they were read; a value is nan where no number stood.

    Attributes:
        impact: of each recording its position in ``impacts.csv``.
        file: of each the file it came from.
        row: of every sample its row there.
        time_column, value_column: what the columns are called there.
        text: what stood in cells that held no number, by the index of the sample.
    """

    impact: IntPerImpact
    file: list[str]
    row: Int[np.ndarray, " sample"]
    time_column: str = "time_s"
    value_column: str = "value"
    text: dict[int, str] = field(default_factory=dict)

    @classmethod
    def joined(cls, parts: Sequence[Samples], signal: SignalSettings) -> Samples:
        """Those of several impacts, each by itself, end to end."""
        flat, columns = Traces.of(parts), (signal.time_column, signal.value_column)
        impact, files = np.array([part.impact[0] for part in parts], int), [part.file[0] for part in parts]
        row = np.concatenate([np.empty(0, int), *(part.row for part in parts)])
        begins = zip(flat.start.tolist(), parts, strict=False)
        text = {at + index: part.text[index] for at, part in begins for index in part.text}
        return cls(flat.time_s, flat.value, flat.start, impact, files, row, *columns, text)

    def taken(self, samples: np.ndarray, rows: np.ndarray, count: np.ndarray) -> Self:
        """These samples of these recordings, so many of each, in order."""
        sites = np.flatnonzero(np.isin(samples, list(self.text))) if self.text else ()
        return replace(
            super().taken(samples, rows, count),
            impact=self.impact[rows],
            file=[self.file[row] for row in rows],
            row=self.row[samples],
            text={int(site): self.text[int(samples[site])] for site in sites},
        )

    @property
    def to_their_ends(self) -> Samples:
        """Without rows behind the end of a recording, in which others of the table go on: they are empty."""
        filled = np.isfinite(self.time_s) | np.isfinite(self.value)
        filled[[at for at, words in self.text.items() if words.strip()]] = True
        if filled.all():
            return self
        at = np.arange(filled.size)
        last = np.maximum.reduceat(np.where(filled, at, -1), self.begin)[self.owner]
        return self.at((at <= last) | (last < 0))

    def kept(self, keep: BoolPerImpact) -> Traces:
        """Those of the impacts that are kept, one truth value for each of ``impacts.csv``."""
        part = self[keep[self.impact]] if not keep.all() else self
        return Traces(part.time_s, part.value, part.start, clipped=part.clipped)


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

    What a sensor reads whose zero is at rest becomes force over mass: see
    `bayestissue.recordings.dataset.Dataset`.
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


def numbers_in(impacts: pd.DataFrame, name: str) -> PerImpact:
    """A column of ``impacts.csv`` that it may lack; nan where it states nothing."""
    if name not in impacts:
        return np.full(len(impacts), np.nan)
    return np.asarray(impacts[name], dtype=np.float64)


def windows_of(impacts: pd.DataFrame, signal: SignalSettings) -> Float64[np.ndarray, "2 impact"]:
    """The times from which and to which each impact is read, both included, on the recorder's clock, s.

    What ``impacts.csv`` says; where a cell is empty, what ``signal.crop`` says, and else infinite.
    """
    cells = np.stack([numbers_in(impacts, name) for name in CROP])
    return np.where(np.isfinite(cells), cells, np.array(ends_of(signal))[:, None])


def crop(
    samples: Samples, windows: Float64[np.ndarray, "2 impact"], names: list[str]
) -> tuple[Samples, list[Problem]]:
    """The samples inside the windows, and what is wrong with impacts that have none there.

    A sample whose time is no number stays, to be found as such.

    Args:
        samples: of the impacts that have any.
        windows: of all impacts.
        names: of all impacts.
    """
    start, stop = windows[:, samples.impact]
    before, after = (end[samples.owner] for end in (start, stop))
    keep = ~((samples.time_s < before) | (samples.time_s > after))
    problems, left = [], np.bincount(samples.owner[keep], minlength=len(samples))
    for which in np.flatnonzero(left == 0):
        time, name = samples[int(which)].time_s, names[samples.impact[which]]
        times = f"times from {time.min():.6g} to {time.max():.6g} s" if time.size else "no samples"
        ends = {"start": start[which], "stop": stop[which]}
        problems.append(Problem.stated("crop.nothing", samples.file[which], value=times, impact=name, **ends))
    return samples.at(keep), problems


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
        return replace(samples, clipped=clipped)
    value = samples.value.copy()
    for sign in (1, -1):
        limits = np.maximum.reduceat(np.where(np.isfinite(value), sign * value, -np.inf), samples.begin)
        if stated is not None:
            limits = np.maximum(limits, sign * stated[sign > 0])
        mine = at[np.sign(samples.value[at]) == sign]
        value[mine] = sign * limits[samples.owner[mine]]
    clipped[at] = np.sign(samples.value[at])
    return replace(samples, value=value, clipped=clipped)


@dataclass(frozen=True, eq=False)
class Recordings:
    """The samples of every impact that has any, and what else the checks need to know.

    Attributes:
        samples: end to end.
        impacts: the rows of ``impacts.csv``, of which each recording has one.
        quantity: what was recorded.
        uncertainty: of the measuring chain.
        gravity: along the motion, m/s².
        recorder: a low-pass that is declared, or None.
    """

    samples: Samples
    impacts: pd.DataFrame
    quantity: Quantity
    uncertainty: Uncertainty
    gravity: float = 0.0
    recorder: LowPassFilter | None = None

    @cached_property
    def name(self) -> OfEach:
        """Of each impact."""
        return self.impacts["impact"].to_numpy()[self.samples.impact]

    @property
    def velocity(self) -> PerImpact:
        """At contact, m/s; nan where it is not known."""
        return numbers_in(self.impacts, "velocity_m_s")[self.samples.impact]

    @property
    def rate(self) -> PerImpact:
        """The sampling rate that ``impacts.csv`` states, Hz; nan where it states none."""
        return numbers_in(self.impacts, "sampling_rate_hz")[self.samples.impact]

    @cached_property
    def moving(self) -> Motion:
        """How far and which way each goes; of recordings whose samples and clocks are sound."""
        return motion(self.samples, self.quantity, self.gravity)

    def without(self, problems: list[Problem]) -> Recordings:
        """The recordings of impacts that none of the problems concerns."""
        return self.of_impacts({*self.impacts["impact"]} - {problem.impact for problem in problems})

    def of_impacts(self, names: Iterable[str]) -> Recordings:
        """The recordings of these impacts."""
        mine = pd.Index(self.name).isin(list(names))
        return self if mine.all() else replace(self, samples=self.samples[mine])

    def problem(
        self, key: str, which: At, value: object, *, at: At | None = None, column: str = "", **numbers: Any
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
        self, wrong: BoolPerImpact, key: str, words: str, values: OfEach, *, column: str = "", **numbers: Any
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
