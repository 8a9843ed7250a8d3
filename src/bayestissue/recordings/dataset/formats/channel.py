"""What every format and table gives: channels of numbers, each with the unit and clock that its file has."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int

from bayestissue.recordings.dataset.dialect import Dialect
from bayestissue.recordings.dataset.ragged_traces import PerSample

# What is found of a file that was cut short.
CUT_OFF = "an end that is missing"
# "Impact (m/s^2)", "Impact [g]": text tables have no other place for a unit.
# A name that stands there twice has its column behind, and a run its number.
_UNIT_IN_NAME = re.compile(r".*[(\[]([^()\[\]]+)[)\]]\s*")
_PLACE = re.compile(r"(\s(Run|Trial) ?#?\d+)?( \(column \d+\))?$", re.IGNORECASE)


@dataclass(frozen=True)
class Channel:
    """One channel of a recorder, or a table's column of numbers.

    Attributes:
        values: as the file gives them, scaled where the format itself defines a scale. Not a number (nan)
            where a cell was empty or held none; infinite of what is beyond a recorder's range.
        clock: the recorder's time of each sample in s, where the format carries one.
        unit: as the file writes it; empty where it states none.
        rows: of each sample the row in the file; None where each has the row behind the one before.
        text: what stood in cells that held no number, by the index of the sample.
        since: of times of day, which are in seconds since the first one here, that first one, s; None of
            others.
    """

    values: PerSample
    clock: PerSample | None = None
    unit: str = ""
    rows: Int[np.ndarray, " sample"] | None = None
    text: dict[int, str] = field(default_factory=dict)
    since: float | None = None

    @classmethod
    def joined(cls, parts: Sequence[Channel]) -> Channel:
        """Several channels end to end, in the unit of the first; rows of one that has none count from 0."""
        begin = np.cumsum([0, *(part.values.size for part in parts)])
        words = zip(begin, (part.text for part in parts), strict=False)
        text = {int(first) + index: text[index] for first, text in words for index in text}
        values = np.concatenate([np.empty(0), *(part.values for part in parts)])
        rows = (np.arange(part.values.size) if part.rows is None else part.rows for part in parts)
        clocks = [part.clock for part in parts if part.clock is not None]
        clock, unit = np.concatenate(clocks) if clocks else None, parts[0].unit if parts else ""
        return cls(values, clock, unit, np.concatenate([np.empty(0, int), *rows]), text)


@dataclass(frozen=True)
class Labels:
    """A column of names, each stored once.

    Attributes:
        codes: for every row the index into ``names``.
        names: in order of appearance; two may be alike that a file writes with other spaces.
    """

    codes: Int[np.ndarray, " row"]
    names: list[str]


@dataclass(frozen=True)
class Contents:
    """The channels of a file that were read, by name; of a recorder's file all.

    Attributes:
        channels: in the order of the file; none where it holds several blocks.
        first_row: the row, or in a binary file the number, of the first sample.
        blocks: the recordings, of a format whose files may hold several.
        labels: columns of names, by name.
        columns: the names of all columns of a table, read or not.
        dialect: how a text table is written; None of other files.
    """

    channels: dict[str, Channel]
    first_row: int = 1
    blocks: tuple[Contents, ...] = ()
    labels: dict[str, Labels] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    dialect: Dialect | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of all that the file has, in its order."""
        return self.columns or tuple(self.channels)

    def rows_of(self, name: str) -> Int[np.ndarray, " sample"]:
        """The row, or in a binary file the number, of each sample of a channel."""
        values, rows = self.channels[name].values, self.channels[name].rows
        return self.first_row + np.arange(values.size) if rows is None else rows


@dataclass(frozen=True)
class Format:
    """One format of recorder files.

    Attributes:
        read: from the bytes of a file, and what to call it in a message, to its contents. It may raise
            `UnfitError`, and on damaged bytes anything at all.
        name: as its users call it.
        suffixes: how its files' names end, in small letters.
        time: what its times are, for the manual,
        value: and its values.
        share: of the bytes that a file may have, for what takes many times its size once it is taken apart.
    """

    read: Callable[[bytes, str], Contents]
    name: str
    suffixes: Sequence[str]
    time: str
    value: str
    share: float = 1.0


class UnfitError(Exception):
    """A whole file that can't serve.

    Args:
        key: of the message in ``remedies.toml`` that says so: see `bayestissue.base.errors.Problem.stated`.
        value: what was found.
        words: in the message.
    """

    def __init__(self, key: str, value: object, **words: object) -> None:
        super().__init__(key)
        self.key, self.value, self.words = key, value, words


def unique(names: Iterable[str], otherwise: str) -> list[str]:
    """The names, each once: an empty one is ``otherwise`` with its number, one that repeats has it behind."""
    named: list[str] = []
    for number, name in enumerate(names, 1):
        name = name or f"{otherwise} {number}"
        named.append(name if name not in named else f"{name} {number}")
    return named


def even_clock(step: object, start: object, samples: int) -> PerSample | None:
    """``start + step · i`` in s for each sample i; None where that is no clock.

    Args:
        step: the sampling interval as a file states it, s.
        start: the time of the first sample, s.
        samples: how many there are.
    """
    if not isinstance(step, (int, float)) or not isinstance(start, (int, float)) or not step > 0:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(start + step * np.arange(samples), dtype=np.float64)


def clock_of(rate: float, samples: int) -> PerSample | None:
    """The times in s of samples taken at a ``rate`` in Hz, the first at 0 s; None where that is none."""
    return even_clock(1 / rate if rate else 0.0, 0.0, samples)


def columns(name: str, values: np.ndarray, most: int = 64) -> dict[str, PerSample]:
    """The channels in an array: a vector by its name, the columns of a table as ``name:1``, ``name:2``.

    A table with more than 64 columns, but not of so many rows, lies on its side: its rows are the channels.
    One of more of both is a picture or the like, and no recording of some channels.
    """
    if max(values.shape, default=1) == values.size:
        return {name: np.ravel(values).astype(np.float64)}
    if values.ndim != 2 or min(values.shape) > most:
        return {}
    upright = values if values.shape[1] <= most else values.T
    return {f"{name}:{number}": column for number, column in enumerate(upright.T.astype(np.float64), 1)}


def of_arrays(arrays: Iterable[tuple[str, np.ndarray, str]]) -> Contents:
    """The channels in arrays of numbers, each with its name and unit, as of `columns`."""
    channels: dict[str, Channel] = {}
    for name, array, unit in arrays:
        channels |= {part: Channel(values, unit=unit) for part, values in columns(name, array).items()}
    return Contents(channels)


def unit_in_name(name: str) -> str:
    """The unit in brackets at the end of a column's name, such as ``Impact (m/s^2)``; empty if none."""
    match = _UNIT_IN_NAME.fullmatch(_PLACE.sub("", name))
    return match[1].strip() if match else ""
