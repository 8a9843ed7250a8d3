"""The designs that a plan compares: who is hit how often by which masses, and the minutes that it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.studies.planning.plan_file import Candidates, Cost, PlannedFactor
from bayestissue.studies.simulation.simulation_file import crossed

# Pairs of mass in kg and velocity in m/s.
Conditions = tuple[tuple[float, float], ...]
_CONDITION = ("trial", "mass_kg", "velocity_m_s")


@dataclass(frozen=True)
class Candidate:
    """One design: every person in every condition, as often as ``repeats`` says.

    Attributes:
        people: how many are recruited.
        conditions: pairs of mass in kg and velocity in m/s.
        repeats: impacts of a person in a condition, at each level of the factors that have ``every``.
        factors: further columns, such as side.
        lost: the share of a measured person's impacts that give no recording.
        lost_people: the share of the people who are recruited and never measured.
        people_named: of a running study, the people who are hit again; they come first.
        trials_named: of the same, conditions as pairs of mass and velocity, each with its name.
        prefix: what names of other people begin with.
        recorder: name of the recorder; empty where one alone is considered.
    """

    people: int
    conditions: Conditions
    repeats: int = 1
    factors: tuple[PlannedFactor, ...] = ()
    lost: float = 0.0
    lost_people: float = 0.0
    people_named: tuple[str, ...] = ()
    trials_named: tuple[tuple[float, float, str], ...] = ()
    prefix: str = "s"
    recorder: str = ""

    @property
    def masses_kg(self) -> tuple[float, ...]:
        """The masses, the smallest first."""
        return tuple(sorted({mass for mass, _ in self.conditions}))

    @property
    def velocities_m_s(self) -> tuple[float, ...]:
        """The velocities, the smallest first."""
        return tuple(sorted({velocity for _, velocity in self.conditions}))

    @property
    def planned_impacts(self) -> int:
        """Impacts of all who are recruited, the lost ones too."""
        levels = np.prod([len(factor.levels) for factor in self._crossed], dtype=int)
        return int(self.people * len(self.conditions) * levels * self.repeats)

    @property
    def _crossed(self) -> tuple[PlannedFactor, ...]:
        """The factors at whose every level each person is hit."""
        return tuple(factor for factor in self.factors if factor.every and factor.within)

    def minutes(self, cost: Cost) -> float:
        """What the study takes: people, impacts, and changes of the mass, one fewer a person than masses."""
        changes = self.people * (len(self.masses_kg) - 1)
        of_people, of_impacts = self.people * cost.person_min, self.planned_impacts * cost.impact_min
        return of_people + of_impacts + changes * cost.mass_change_min

    def rows(self) -> pd.DataFrame:
        """The impacts that give a recording: ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s``, factors.

        Lost impacts are spread over people and conditions as by chance, but always the same ones.
        """
        measured = max(self.people - round(self.lost_people * self.people), min(self.people, 1))
        others = (f"{self.prefix}{number + 1:03d}" for number in range(measured))
        names = {pair: "{:g} kg at {:g} m/s".format(*pair) for pair in self.conditions}
        names |= {(mass, velocity): name for mass, velocity, name in self.trials_named}
        table = crossed(
            pd.DataFrame({"subject": [*self.people_named, *others][:measured]}, dtype=str),
            pd.DataFrame([(names[pair], *map(float, pair)) for pair in self.conditions], columns=_CONDITION),
            *(pd.DataFrame({factor.name: factor.levels}) for factor in self._crossed),
            repeats=self.repeats,
        ).reset_index(drop=True)
        random = np.random.default_rng(0)
        for factor in self.factors:
            if factor.of_people:
                level = np.array(factor.levels)[np.arange(measured) % len(factor.levels)]
                table[factor.name] = level[pd.factorize(table["subject"])[0]]
            elif not factor.every:
                table[factor.name] = random.permutation(np.resize(factor.levels, len(table)))
        remaining = len(table) - round(self.lost * len(table))
        return table.iloc[np.sort(random.permutation(len(table))[:remaining])].reset_index(drop=True)

    def columns(self) -> dict[str, Any]:
        """What tables say of the design, but for its cost."""
        return {
            "people": self.people,
            "masses_kg": " ".join(f"{mass:g}" for mass in self.masses_kg),
            "velocities_m_s": " ".join(f"{velocity:g}" for velocity in self.velocities_m_s),
            "conditions": len(self.conditions),
            "repeats": self.repeats,
            "recorder": self.recorder,
            "impacts": self.planned_impacts,
        }


def grid(candidates: Candidates, recorders: Sequence[str] = ("",)) -> list[Candidate]:
    """Every combination of what the plan lists, people varying fastest.

    Its conditions are each set of masses at each set of velocities, and the set that is listed condition by
    condition.

    Args:
        candidates: the lists.
        recorders: names of the recorders that are compared.
    """
    sets = [tuple(product(*pair)) for pair in product(candidates.masses_kg, candidates.velocities_m_s)]
    if candidates.conditions:
        sets.append(tuple(condition.mass_and_velocity() for condition in candidates.conditions))
    common = Candidate(0, (), 1, candidates.factors, candidates.lost, candidates.lost_people)
    return [
        replace(common, people=people, conditions=conditions, repeats=repeats, recorder=recorder)
        for recorder, conditions, repeats, people in product(
            recorders, sets, candidates.repeats, candidates.people
        )
    ]


def largest_of_each(designs: Sequence[Candidate]) -> dict[Conditions, Candidate]:
    """Of each set of conditions the design with the most impacts, which tells all that any of it can."""
    impacts = attrgetter("planned_impacts")
    return {
        conditions: max((design for design in designs if design.conditions == conditions), key=impacts)
        for conditions in dict.fromkeys(design.conditions for design in designs)
    }
