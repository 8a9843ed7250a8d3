"""Studies that were assessed for a plan, kept by all that they depend on: a longer plan goes on from them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.base import runtime
from bayestissue.base.result import Say
from bayestissue.base.results.files import whole_file
from bayestissue.base.settings import TomlTable
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.studies.planning.assurance import PER_STUDY, Assessment, Goal, planner
from bayestissue.studies.planning.candidates import Candidate
from bayestissue.studies.planning.design_prior import BLOCK, DesignPrior
from bayestissue.studies.planning.plan_file import Aim
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS
from bayestissue.studies.planning.running import Running
from bayestissue.studies.simulation.simulation_file import Simulation

_COLUMNS = ["key", "study", "normal", *PER_STUDY]


@dataclass(frozen=True, eq=False)
class Case:
    """One design with its analysis, what is believed of the tissue, and the measuring chain."""

    design: Candidate
    model: ModelSpecification
    prior: DesignPrior
    simulation: Simulation
    running: Running = field(default_factory=Running)

    @cached_property
    def key(self) -> str:
        """A hash of all that its studies depend on, but for the seed."""
        rows = self.design.rows().to_csv(index=False)
        chain = self.simulation.model_dump_json()
        recorded, prior = _content(self.running.centre), _content(self.prior)
        return sha256_of([rows, self.model.model_dump_json(), prior, chain, recorded, runtime.versions()])


class Ledger:
    """Studies that were assessed, by what they depend on, so that more of them go on from there.

    Each study's answers are kept by the hash of its case and goal.

    Args:
        goals: what is asked of every case.
        aim: how sure an answer is to be, and the seed.
        say: told how many of all blocks of studies are done.
        known: studies of an earlier plan.
        parts: a folder in which studies are safe while others are made.
    """

    def __init__(
        self,
        goals: Sequence[Goal],
        aim: Aim,
        say: Say,
        known: pd.DataFrame | None = None,
        parts: Path | None = None,
    ) -> None:
        self._goals, self._aim, self._say, self._parts = goals, aim, say, parts
        self._studies: dict[str, pd.DataFrame] = {}
        self._used: set[str] = set()
        if known is not None:
            self._add(known)
        for path in sorted(parts.glob("*.parquet")) if parts else ():
            self._add(pd.read_parquet(path))

    def assess(self, cases: Sequence[Case], studies: int) -> list[list[Assessment]]:
        """What so many studies say, by case and goal."""
        blocks = studies // BLOCK
        groups: dict[tuple[int, ...], list[Case]] = {}
        for case in cases:
            done = min(len(self._studies.get(self._key(case, goal), ())) for goal in self._goals) // BLOCK
            if done < blocks:
                shared = id(case.model), id(case.prior), id(case.simulation)
                groups.setdefault((done, *shared), []).append(case)
        total = sum((blocks - first) * len(group) for (first, *_), group in groups.items())
        before = 0
        for (first, *_), group in groups.items():
            one = group[0]
            rows, seed = [case.design.rows() for case in group], self._aim.seed
            ready = planner(rows, one.model, one.prior, one.simulation, seed=seed, running=one.running)
            for begin in range(first, blocks, SETTINGS.kept_blocks):
                now, say = range(begin, min(begin + SETTINGS.kept_blocks, blocks)), self._after(before, total)
                assessed = ready.assess(self._goals, now, probability=self._aim.probability, progress=say)
                self._keep(group, assessed, begin * BLOCK, normal=ready.information.is_gaussian)
                before += len(now) * len(group)
        return [[self._read(self._key(case, goal), goal, studies) for goal in self._goals] for case in cases]

    def table(self) -> pd.DataFrame:
        """All studies that were asked for, a row each."""
        used = [table for key, table in self._studies.items() if key in self._used]
        return pd.concat(used, ignore_index=True)

    def _after(self, before: int, total: int) -> Callable[[str, int, int], None]:
        return lambda stage, done, _: self._say(stage, before + done, total)

    def _key(self, case: Case, goal: Goal) -> str:
        what = [case.key, goal.text, goal.width is None, goal.relative, self._aim.seed]
        return sha256_of(what)[:32]

    def _keep(
        self, cases: Sequence[Case], assessed: list[list[Assessment]], first: int, *, normal: bool
    ) -> None:
        table = pd.concat(
            [
                one.table.assign(key=self._key(case, one.goal), study=first + one.table.index, normal=normal)
                for case, of_case in zip(cases, assessed, strict=True)
                for one in of_case
            ],
            ignore_index=True,
        )[_COLUMNS]
        self._add(table)
        if self._parts is not None:
            name = sha256_of([case.key for case in cases])[:16]
            with whole_file(self._parts / f"{name}-{first}.parquet") as path:
                table.to_parquet(path, index=False)

    def _add(self, table: pd.DataFrame) -> None:
        """Studies of any cases and goals; of some of them more may be known already than of others."""
        for key, further in table.groupby("key", sort=False):
            studies = pd.concat([self._studies.get(str(key), further[:0]), further])
            self._studies[str(key)] = studies.drop_duplicates("study").sort_values("study")

    def _read(self, key: str, goal: Goal, studies: int) -> Assessment:
        self._used.add(key)
        return Assessment(goal, self._aim.probability, self._studies[key][:studies])


def _content(value: Any) -> Any:
    """All that a value is made of, as JSON has it; of numbers in arrays their SHA-256."""
    match value:
        case TomlTable():
            return value.model_dump(mode="json")
        case np.ndarray() | xr.DataArray():
            return hashlib.sha256(np.ascontiguousarray(value, float)).hexdigest()
        case Mapping():
            return {str(name): _content(part) for name, part in value.items()}
        case _ if is_dataclass(value):
            return {part.name: _content(getattr(value, part.name)) for part in fields(value)}
    return value


def sha256_of(content: Any) -> str:
    """Of what JSON has of some content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
