"""The recordings with what `impacts.csv` says of them, and the words for what is wrong with one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from jaxtyping import Float64, Shaped

from bayestissue.dataset.model import Quantity, Recorder, Uncertainty
from bayestissue.dataset.samples import Samples
from bayestissue.errors import Problem
from bayestissue.remedies import Code


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
    def of(
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
        """Those of the impacts that none of the problems concerns."""
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
