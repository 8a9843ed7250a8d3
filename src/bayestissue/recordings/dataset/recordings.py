"""Recordings as they were read: where samples stand, cropping, how far each goes, what is wrong with one."""

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
from bayestissue.recordings.dataset.dataset_file import Quantity, Settings, SignalSettings
from bayestissue.recordings.dataset.formats.channel import Channel
from bayestissue.recordings.dataset.plausible import PLAUSIBLE
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
class Motion:
    """How far, how fast and which way each recording goes, in SI units.

    Attributes:
        low, high: the least and greatest recorded value.
        peak: where the greatest displacement stands, or the greatest deceleration.
        extreme: the value farthest from the first one on the side to which the recording first goes, less
            that first one. An impactor that has left the tissue may go farther than it came in.
        pulse: how many samples exceed a tenth of the greatest deceleration; all, for displacements.
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
    greatest = traces.greatest(slowing)
    displaced = traces.value - traces.value[begin][owner]
    farthest = traces.greatest(np.abs(displaced))[owner]
    begins = traces.first_where(np.abs(displaced) >= PLAUSIBLE.begins * farthest)
    side = np.where(displaced[begins] < 0, -1.0, 1.0)
    interval = traces.interval
    peak = traces.first_where(slowing == greatest[owner])
    loss = gain = pulse_loss = rise = np.zeros(begin.size)
    pulse = traces.n_samples
    if quantity != "displacement":
        above, position = slowing > PLAUSIBLE.pulse * greatest[owner], np.arange(owner.size)
        pulse = traces.total(above)
        below = np.where(~above & (position < peak[owner]), position, begin[owner])
        rise = traces.time_s[peak] - traces.time_s[traces.greatest(below)]
        # An offset can't add up to much over a recording that is hardly longer than the impact.
        baseline = np.where(2 * pulse < traces.n_samples, _rest(traces, slowing), 0)
        step = np.append(np.diff(traces.time_s), 0)
        # The step from one recording to the next means nothing.
        step[end - 1] = 0
        loss = _climb(traces, slowing - gravity, step)
        gain = _climb(traces, np.minimum(baseline, 0)[owner] - slowing, step)
        pulse_loss = _climb(traces, slowing - np.maximum(baseline, 0)[owner] - gravity, step)
    return Motion(
        low=traces.least(traces.value),
        high=traces.greatest(traces.value),
        peak=peak,
        extreme=side * traces.greatest(side[owner] * displaced),
        pulse=pulse,
        rise=rise,
        loss=loss,
        gain=gain,
        pulse_loss=pulse_loss,
        step_loss=np.maximum(greatest, 0) * interval,
    )


def _climb(traces: Traces, rate: np.ndarray, step: np.ndarray) -> np.ndarray:
    begin, owner = traces.begin, traces.owner
    # In units of what each recording could reach at most, so that an absurd one can't drown the others.
    unit = traces.greatest(np.abs(rate)) * traces.total(step)
    unit = np.where(unit > 0, unit, 1)
    trapezoids = 0.5 * (rate + np.append(rate[1:], 0)) * step / unit[owner]
    total = np.concatenate([[0], np.cumsum(trapezoids)])[:-1]
    # Each recording is moved below all earlier ones, so that the running minimum starts anew with it.
    total -= total[begin][owner] + 4 * owner
    return traces.greatest(total - np.minimum.accumulate(total)) * unit


def _rest(traces: Traces, values: np.ndarray) -> np.ndarray:
    # Of a recording's two ends, the level of the one nearer to zero: an offset, or less than one.
    begin, end = traces.begin, traces.end
    few = np.minimum(np.maximum(traces.n_samples // 50, 3), traces.n_samples)
    total = np.concatenate([[0], np.cumsum(values)])
    first = (total[begin + few] - total[begin]) / few
    last = (total[end] - total[end - few]) / few
    return np.where(np.abs(first) < np.abs(last), first, last)


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
        last = self.greatest(np.where(filled, at, -1))[self.owner]
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
            problems.append(self.problem("crop.nothing", which, times, column=None, **ends))
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
            limits = self.greatest(np.where(np.isfinite(value), sign * value, -np.inf))
            if stated is not None:
                limits = np.maximum(limits, sign * stated[sign > 0])
            mine = at[np.sign(self.value[at]) == sign]
            value[mine] = sign * limits[self.owner[mine]]
        clipped[at] = np.sign(self.value[at])
        return replace(self, value=value, clipped=clipped)

    def traces_of(self, keep: BoolPerImpact) -> Traces:
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

    def problem(self, key: str, which: At, value: object, *, at: At | None = None, **words: Any) -> Problem:
        """What is wrong with recording ``which``, at the sample ``at`` if it is one sample's fault.

        Args:
            key: of the message: see `Problem.stated`.
            which: recording.
            value: what was found.
            at: which sample.
            words: in the message; a ``column`` other than that of the values.
        """
        file = self.table or str(self.impacts["trace"].iloc[self.position[which]])
        row = None if at is None else int(self.row[at])
        where = {
            "row": row,
            "column": self.signal.value_column,
            "value": value,
            "impact": str(self.name[which]),
        }
        return Problem.stated(key, file, **where | words)

    def where(
        self, wrong: BoolPerImpact, key: str, words: str, values: OfEach, **numbers: Any
    ) -> Iterator[Problem]:
        """A problem for each recording that is ``wrong``; arguments as of `problem`.

        Args:
            wrong: which recordings are.
            key: of the message.
            words: what is there instead, with braces for the number.
            values: that number of each recording.
            numbers: in the message, or the ``column``; an array has one of each recording.
        """
        for which in np.flatnonzero(wrong):
            here = {name: n[which] if isinstance(n, np.ndarray) else n for name, n in numbers.items()}
            yield self.problem(key, which, words.format(values[which]), **here)
