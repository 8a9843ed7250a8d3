"""All recordings of a dataset end to end in one array, so that checks and conversions need no loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int

from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.units import to_si
from bayestissue.errors import Problem


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

    @property
    def count(self) -> np.ndarray:
        """How many samples each impact has."""
        return np.diff(self.start)

    @property
    def owner(self) -> np.ndarray:
        """For every sample which of the recordings it belongs to."""
        return np.repeat(np.arange(self.impact.size), self.count)

    def only(self, keep: np.ndarray) -> Samples:
        """The recordings for which ``keep`` (one truth value each) holds."""
        if keep.all():
            return self
        mask = np.repeat(keep, self.count)
        return Samples(
            self.time[mask],
            self.value[mask],
            np.concatenate([[0], np.cumsum(self.count[keep])]),
            self.impact[keep],
            [file for file, kept in zip(self.file, keep, strict=True) if kept],
            self.row[mask],
            self.time_column,
            self.value_column,
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
