"""Studies that were assessed for a plan, kept by all that they depend on: a longer plan goes on from them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
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
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS
from bayestissue.studies.planning.planned_population import BLOCK, DesignPrior
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
    running: Running | None = None

    @cached_property
    def key(self) -> str:
        """A hash of all that its studies depend on, but for the seed."""
        rows = self.design.rows().to_csv(index=False)
        chain = self.simulation.model_dump_json()
        recorded = "" if self.running is None else _content(self.running.centre)
        model, prior = self.model.model_dump_json(), _content(self.prior)
        return sha256_of([rows, model, prior, chain, recorded, runtime.versions()])


class Ledger:
    """Studies that were assessed, by what they depend on, so that more of them go on from there.

    Each study's answers are kept by the hash of its case and goal; ``parts`` is a folder in which they are
    safe while the others are made.
    """

    def __init__(
        self,
        seed: int,
        probability: float,
        say: Say,
        known: pd.DataFrame | None = None,
        parts: Path | None = None,
    ) -> None:
        self._seed, self._probability, self._say, self._parts = seed, probability, say, parts
        tables = [] if known is None else [known]
        tables += [pd.read_parquet(path) for path in sorted(parts.glob("*.parquet"))] if parts else []
        everything = pd.concat(tables) if tables else pd.DataFrame(columns=_COLUMNS)
        once = everything.drop_duplicates(["key", "study"]).sort_values("study", kind="stable")
        self._studies = {str(key): table for key, table in once.groupby("key", sort=False)}
        self._used: set[str] = set()

    def assess(self, cases: Sequence[Case], goals: Sequence[Goal], studies: int) -> list[list[Assessment]]:
        """What so many studies say, by case and goal."""
        blocks = studies // BLOCK
        groups: dict[tuple[int, ...], list[Case]] = {}
        for case in cases:
            done = min(len(self._studies.get(self._key(case, goal), ())) for goal in goals) // BLOCK
            if done < blocks:
                shared = id(case.model), id(case.prior), id(case.simulation)
                groups.setdefault((done, *shared), []).append(case)
        total = sum((blocks - first) * len(group) for (first, *_), group in groups.items())
        before = 0
        for (first, *_), group in groups.items():
            one = group[0]
            rows = [case.design.rows() for case in group]
            ready = planner(rows, one.model, one.prior, one.simulation, seed=self._seed, running=one.running)
            for begin in range(first, blocks, SETTINGS.kept_blocks):
                now, say = range(begin, min(begin + SETTINGS.kept_blocks, blocks)), self._after(before, total)
                answers = ready.assess(goals, now, probability=self._probability, progress=say)
                self._keep(group, answers, begin * BLOCK, normal=ready.information.is_gaussian)
                before += len(now) * len(group)
        return [[self._read(self._key(case, goal), goal, studies) for goal in goals] for case in cases]

    def table(self) -> pd.DataFrame:
        """All studies that were asked for, a row each."""
        used = [table for key, table in self._studies.items() if key in self._used]
        return pd.concat(used, ignore_index=True)

    def _after(self, before: int, total: int) -> Callable[[str, int, int], None]:
        return lambda stage, done, _: self._say(stage, before + done, total)

    def _key(self, case: Case, goal: Goal) -> str:
        what = [case.key, goal.text, goal.width is None, goal.relative, goal.level, self._seed]
        return sha256_of(what)[:32]

    def _keep(
        self, cases: Sequence[Case], answers: list[list[Assessment]], first: int, *, normal: bool
    ) -> None:
        tables = []
        for case, of_case in zip(cases, answers, strict=True):
            for one in of_case:
                key, number = self._key(case, one.goal), first + np.arange(one.studies)
                tables.append(one.table().assign(key=key, study=number, normal=normal)[_COLUMNS])
                # Of a goal that was asked for before, more may be known than of the others.
                studies = pd.concat([self._studies.get(key, tables[-1][:0]), tables[-1]])
                self._studies[key] = studies.drop_duplicates("study").sort_values("study")
        if self._parts is not None:
            name = sha256_of([case.key for case in cases])[:16]
            with whole_file(self._parts / f"{name}-{first}.parquet") as path:
                pd.concat(tables, ignore_index=True).to_parquet(path, index=False)

    def _read(self, key: str, goal: Goal, studies: int) -> Assessment:
        self._used.add(key)
        return Assessment.from_table(goal, self._probability, self._studies[key][:studies])


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
