"""A stand-in for the kernel: assurance that grows with the impacts, by a rule that tests can work out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.result import Say
from bayestissue.studies.planning import ledger as module
from bayestissue.studies.planning.assurance import Assessment, Goal
from bayestissue.studies.planning.design_prior import BLOCK


def share(rows: pd.DataFrame, most: float = 1.0) -> float:
    """The assurance of a design: the impacts over 200, no more than ``most``."""
    return min(len(rows) / 200, most)


@dataclass
class Kernel:
    """What was asked of it: the number of designs and the blocks of each call."""

    most: float = 1.0
    normal: bool = True
    calls: list[tuple[int, range]] = field(default_factory=list)

    def __call__(
        self,
        designs: Sequence[pd.DataFrame],
        _model: Any,
        _prior: Any,
        _simulation: Any,
        *,
        seed: int,
        running: Any = None,
    ) -> Ready:
        return Ready(self, designs)


@dataclass
class Traces:
    is_gaussian: bool


@dataclass
class Ready:
    kernel: Kernel
    designs: Sequence[pd.DataFrame]

    @property
    def information(self) -> Traces:
        return Traces(self.kernel.normal)

    def assess(
        self, goals: Sequence[Goal], blocks: range, *, probability: float, progress: Say
    ) -> list[list[Assessment]]:
        self.probability = probability
        self.kernel.calls.append((len(self.designs), blocks))
        progress("assessing designs", len(self.designs) * len(blocks), len(self.designs) * len(blocks))
        study = (np.arange(blocks.start * BLOCK, blocks.stop * BLOCK) % 100 + 0.5) / 100
        return [[self._of(rows, goal, study) for goal in goals] for rows in self.designs]

    def _of(self, rows: pd.DataFrame, goal: Goal, study: np.ndarray) -> Assessment:
        answered = study < share(rows, self.kernel.most)
        if goal.width is not None:
            width, p, truth = goal.width * np.where(answered, 0.9, 1.2), study * np.nan, study > 0
        else:
            yes = study * 100 % 4 > 1
            p, truth = np.where(answered, np.where(yes, 0.99, 0.01), 0.5), yes ^ (study < 0.03)
            width = study * np.nan
        table = pd.DataFrame({"p": p, "true": truth, "width": width, "effective": 64.0})
        return Assessment(goal, self.probability, table)


@contextmanager
def kernel(most: float = 1.0, *, normal: bool = True) -> Iterator[Kernel]:
    """Plans within the block are assessed by the stand-in."""
    stand_in = Kernel(most, normal)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "planner", stand_in)
        yield stand_in
