"""All recordings of a dataset end to end in one array, with what `impacts.csv` says of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int, Shaped

from bayestissue.dataset.model import Quantity, Recorder, Uncertainty
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.units import to_si
from bayestissue.errors import Problem
from bayestissue.remedies import Code


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
            [file for file, is_kept in zip(self.file, keep, strict=True) if is_kept],
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
    recorder: Recorder | None = None

    @classmethod
    def with_impacts(
        cls,
        samples: Samples,
        impacts: pd.DataFrame,
        quantity: Quantity,
        uncertainty: Uncertainty,
        gravity: float = 0.0,
        recorder: Recorder | None = None,
    ) -> Recordings:
        """Put the rows of ``impacts`` beside the samples."""
        mine = impacts.iloc[samples.impact]
        rate = mine.get("sampling_rate_hz", pd.Series(np.nan, index=mine.index))
        return cls(
            samples,
            mine["impact"].to_numpy(),
            mine["velocity_m_s"].to_numpy(),
            rate.to_numpy(),
            quantity,
            uncertainty,
            gravity,
            recorder,
        )

    def without(self, problems: list[Problem]) -> Recordings:
        """The recordings of impacts that none of the problems concerns."""
        bad = {problem.impact for problem in problems}
        keep = np.array([name not in bad for name in self.name], dtype=bool)
        return replace(
            self,
            samples=self.samples.only(keep),
            name=self.name[keep],
            velocity=self.velocity[keep],
            rate=self.rate[keep],
        )

    def problem(
        self,
        which: int | np.integer,
        expected: str,
        remedy: str,
        *,
        value: object,
        at: int | np.integer | None = None,
        column: str | None = None,
        code: Code,
    ) -> Problem:
        """What is wrong with recording ``which``, at the sample ``at`` if it is one sample's fault."""
        return Problem(
            self.samples.file[which],
            expected,
            remedy,
            row=None if at is None else int(self.samples.row[at]),
            column=column or self.samples.value_column,
            value=value,
            impact=str(self.name[which]) or None,
            code=code,
        )
