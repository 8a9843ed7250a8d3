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
from bayestissue.recordings.dataset.dataset_file import Settings, SignalSettings
from bayestissue.recordings.dataset.formats.channel import Channel
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


@dataclass(frozen=True, eq=False)
class Recordings(Traces):
    """One channel's recordings of all impacts that have one, as they were read, and what is wrong with them.

    A value is nan where no number stood.

    Attributes:
        position: of each recording its row among ``impacts``.
        row: of every sample its row in its file.
        text: what stood in cells that held no number, by the index of the sample.
        settings: what ``dataset.toml`` says.
        signal: the settings by which this channel is read.
        impacts: the rows of ``impacts.csv``.
        table: what messages call the table that all samples stood in; empty where each impact has a file.
        problems: what is wrong with single impacts, those without a recording too.
        warnings: what only looks odd.
        paths: of the files that were read.
    """

    position: IntPerImpact
    row: Int[np.ndarray, " sample"]
    text: dict[int, str]
    settings: Settings
    signal: SignalSettings
    impacts: pd.DataFrame = field(default_factory=pd.DataFrame)
    table: str = ""
    problems: Sequence[Problem] = ()
    warnings: Sequence[Problem] = ()
    paths: Sequence[Path] = ()

    @classmethod
    def from_channel(cls, recorded: Channel, count: Iterable[int], *attributes: Any) -> Recordings:
        """Recordings of so many samples each, one behind the other in a channel.

        Args:
            recorded: with times in s; its values become those in SI units.
            count: of each impact, 0 where there is no recording.
            attributes: ``settings``, ``signal`` and what follows.
        """
        time, value = np.asarray(recorded.clock), in_si(recorded.values, attributes[1])
        start, row = np.cumsum([0, *count]), np.asarray(recorded.rows)
        return cls(time, value, start, np.arange(start.size - 1), row, recorded.text, *attributes)

    @classmethod
    def joined(cls, parts: Sequence[Recordings], *attributes: Any) -> Recordings:
        """Those of several impacts, each by itself, end to end; ``attributes`` as of `from_channel`."""
        flat, position = Traces.of(parts), np.array([part.position[0] for part in parts], int)
        begins = zip(flat.start.tolist(), parts, strict=False)
        text = {at + index: part.text[index] for at, part in begins for index in part.text}
        row = np.concatenate([np.empty(0, int), *(part.row for part in parts)])
        return cls(flat.time_s, flat.value, flat.start, position, row, text, *attributes)

    def taken(self, samples: np.ndarray, rows: np.ndarray, count: np.ndarray) -> Self:
        """These samples of these recordings, so many of each, in order."""
        sites = np.flatnonzero(np.isin(samples, list(self.text))) if self.text else ()
        return replace(
            super().taken(samples, rows, count),
            position=self.position[rows],
            row=self.row[samples],
            text={int(site): self.text[int(samples[site])] for site in sites},
        )

    @property
    def to_their_ends(self) -> Self:
        """Without rows behind the end of a recording, in which others of the table go on: they are empty."""
        filled = np.isfinite(self.time_s) | np.isfinite(self.value)
        filled[[at for at, words in self.text.items() if words.strip()]] = True
        if filled.all():
            return self
        at = np.arange(filled.size)
        last = np.maximum.reduceat(np.where(filled, at, -1), self.begin)[self.owner]
        return self.at((at <= last) | (last < 0))

    @property
    def cropped(self) -> Self:
        """The samples inside the windows that are stated, and a problem for each impact that has none there.

        A sample whose time is no number stays, to be found as such.
        """
        start, stop = windows_of(self.impacts.iloc[self.position], self.signal)
        before, after = (end[self.owner] for end in (start, stop))
        keep = ~((self.time_s < before) | (self.time_s > after))
        problems, left = [], np.bincount(self.owner[keep], minlength=len(self))
        for which in np.flatnonzero(left == 0):
            time, ends = self[int(which)].time_s, {"start": start[which], "stop": stop[which]}
            times = f"times from {time.min():.6g} to {time.max():.6g} s" if time.size else "no samples"
            problems.append(self.problem("crop.nothing", which, times, **ends))
        return replace(self.at(keep), problems=[*self.problems, *problems])

    @property
    def with_limits(self) -> Self:
        """The recordings with what `at_limit` finds, and what a recorder itself wrote as beyond its range.

        That has the greatest value of the recording on its side, or the one that was stated.
        """
        stated = self.signal.limits_si
        said = [at for at, words in self.text.items() if words.strip() in BEYOND_LIMIT]
        at = np.array([i for i in said if np.isinf(self.value[i])], int)
        clipped = at_limit(self, self.signal.quantity, stated)
        if not at.size:
            return replace(self, clipped=clipped)
        value = self.value.copy()
        for sign in (1, -1):
            limits = np.maximum.reduceat(np.where(np.isfinite(value), sign * value, -np.inf), self.begin)
            if stated is not None:
                limits = np.maximum(limits, sign * stated[sign > 0])
            mine = at[np.sign(self.value[at]) == sign]
            value[mine] = sign * limits[self.owner[mine]]
        clipped[at] = np.sign(self.value[at])
        return replace(self, value=value, clipped=clipped)

    def of_kept(self, keep: BoolPerImpact) -> Traces:
        """The traces of the impacts that are kept, one truth value for each of ``impacts``."""
        part = self[keep[self.position]] if not keep.all() else self
        return Traces(part.time_s, part.value, part.start, clipped=part.clipped)

    @cached_property
    def name(self) -> OfEach:
        """Of each impact."""
        return self.impacts["impact"].to_numpy()[self.position]

    @property
    def velocity(self) -> PerImpact:
        """At contact, m/s; nan where it is not known."""
        return numbers_in(self.impacts, "velocity_m_s")[self.position]

    @cached_property
    def moving(self) -> Motion:
        """How far and which way each goes; of recordings whose samples and clocks are sound."""
        return motion(self, self.settings.signal.quantity, self.settings.signal.gravity_m_s2)

    def without(self, problems: Iterable[Problem]) -> Self:
        """The recordings of impacts that none of the problems concerns."""
        return self.of_impacts({*self.impacts["impact"]} - {problem.impact for problem in problems})

    def of_impacts(self, names: Iterable[str]) -> Self:
        """The recordings of these impacts."""
        mine = pd.Index(self.name).isin(list(names))
        return self if mine.all() else self[mine]

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
        file = self.table or str(self.impacts["trace"].iloc[self.position[which]])
        row = None if at is None else int(self.row[at])
        column = column or self.signal.value_column
        return Problem.stated(key, file, row, column, value, impact=str(self.name[which]), **numbers)

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
