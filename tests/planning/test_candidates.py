"""The designs of a plan: their grid, their impacts, and the minutes that they take."""

from __future__ import annotations

import pytest

from bayestissue.studies.planning.candidates import Candidate, grid, largest_of_each
from bayestissue.studies.planning.plan_file import Candidates, Cost, PlannedFactor

SIDE = PlannedFactor(name="side", levels=("left", "right"))
TWO = ((0.5, 1.5), (1.0, 1.5))


def test_lists_together_are_a_grid() -> None:
    lists = Candidates.model_validate(
        {"people": [10, 20], "masses_kg": [[0.5, 1.0], [0.4, 0.7, 1.2]], "repeats": [1, 3]}
    )
    designs = grid(lists)
    assert len(designs) == 8
    assert [design.people for design in designs[:4]] == [10, 20, 10, 20]
    assert {len(design.conditions) for design in designs} == {2, 3}


def test_conditions_that_are_no_grid_are_one_more_set() -> None:
    pairs = [{"trial": "a", "mass_kg": 0.5, "velocity_m_s": 1}, {"trial": "b", "mass_kg": 1, "energy_J": 2}]
    designs = grid(Candidates.model_validate({"people": 5, "masses_kg": [0.7], "conditions": pairs}))
    assert [design.conditions for design in designs] == [((0.7, 1.5),), ((0.5, 1.0), (1.0, 2.0))]


def test_every_person_is_hit_in_every_condition_at_every_level() -> None:
    rows = Candidate(4, TWO, repeats=3, factors=(SIDE,)).rows()
    assert len(rows) == 4 * 2 * 3 * 2
    assert (rows.groupby(["subject", "trial", "side"]).size() == 3).all()
    assert set(rows["trial"]) == {"0.5 kg at 1.5 m/s", "1 kg at 1.5 m/s"}


def test_people_belong_to_one_level_of_a_group_of_people() -> None:
    sex = PlannedFactor(name="sex", levels=("f", "m"), of_people=True)
    design = Candidate(5, TWO, factors=(sex, SIDE))
    rows = design.rows()
    assert (rows.groupby("subject")["sex"].nunique() == 1).all()
    assert rows.groupby("sex")["subject"].nunique().to_dict() == {"f": 3, "m": 2}
    assert len(rows) == design.planned_impacts == 5 * 2 * 2


@pytest.mark.parametrize(("lost", "lost_people", "people", "impacts"), [(0.1, 0, 10, 54), (0, 0.2, 8, 48)])
def test_what_is_lost_is_missing_and_always_the_same(lost, lost_people, people, impacts) -> None:
    design = Candidate(10, TWO, repeats=3, lost=lost, lost_people=lost_people)
    rows = design.rows()
    assert rows["subject"].nunique() == people
    assert len(rows) == impacts
    assert rows.equals(design.rows())
    # What is lost was planned, and costs.
    assert design.planned_impacts == 60


def test_minutes_are_of_people_impacts_and_changes_of_the_mass() -> None:
    cost = Cost(person_min=20, impact_min=1, mass_change_min=2)
    conditions = ((0.4, 1.5), (0.7, 1.5), (1.2, 1.5), (1.2, 2.0))
    assert Candidate(10, conditions, repeats=3).minutes(cost) == 10 * 20 + 120 * 1 + 10 * 2 * 2


def test_the_largest_design_of_each_set_of_conditions() -> None:
    designs = [Candidate(10, TWO), Candidate(30, TWO), Candidate(20, TWO), Candidate(5, TWO[:1])]
    assert largest_of_each(designs) == {TWO: designs[1], TWO[:1]: designs[3]}
