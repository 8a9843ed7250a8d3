"""The plan file: what it may say, and that everything wrong is named before any work."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import xarray as xr

from bayestissue.base.errors import InputError, Problem
from bayestissue.studies.planning import planned_study
from bayestissue.studies.planning.plan_file import plan_of
from bayestissue.studies.planning.planned_study import PlannedStudy, factors_named, study_of
from cases import cases

SIDES = {"name": "side", "levels": ["left", "right"]}
PLAN: dict[str, Any] = {
    "candidates": {"people": [10, 20], "masses_kg": [0.5, 1.0], "repeats": [2], "factors": [SIDES]},
    "questions": {"left": "K[side=left] / K[side=right] > 1.1"},
}


def planned(**changed: Any) -> PlannedStudy:
    return study_of(plan_of(PLAN | changed, "plan.toml"), "plan.toml")


def refused(**changed: Any) -> dict[str | None, Problem]:
    """The problems of the plan with other tables, by key."""
    with pytest.raises(InputError) as caught:
        planned(**changed)
    return {problem.column: problem for problem in caught.value.problems}


@pytest.mark.parametrize("case", cases(__file__))
def test_what_is_wrong_is_named_before_any_work(case: dict[str, Any]) -> None:
    problems = refused(**{key: table for key, table in case.items() if key != "says"})
    assert {column or None for column in case["says"]} <= set(problems)
    for column, words in case["says"].items():
        problem = problems[column or None]
        text = f"{problem.value} {problem.expected} {problem.remedy}"
        assert all(part in text for part in ([words] if isinstance(words, str) else words)), text


def test_too_many_designs_are_refused() -> None:
    many = {"people": list(range(1, 400)), "masses_kg": [[0.5], [1.0]]}
    assert "at most 500 designs" in refused(candidates=many)["candidates"].expected


@pytest.mark.parametrize(
    ("factor", "question", "formula"),
    [
        (SIDES, "K[side=left] > K[side=right]", "side + (1|subject) + (1|trial) + (1|subject:side)"),
        (SIDES | {"name": "Side"}, "K[side=left] > 1", "Side + (1|subject) + (1|trial) + (1|subject:Side)"),
        # Of people there are no effects within a person.
        (
            {"name": "sex", "levels": ["f", "m"], "of_people": True},
            "K[sex=f] < K[sex=m]",
            "sex + (1|subject) + (1|trial)",
        ),
    ],
)
def test_the_default_formula_has_the_factors_that_are_asked_for(factor, question, formula) -> None:
    study = planned(candidates=PLAN["candidates"] | {"factors": [factor]}, questions={"a": question})
    first, second, *_ = (case.model for case in study.cases)
    assert first.formula.K == first.formula.C == f"log(mass_kg) + {formula}"
    assert first is second
    assert first.reference_mass_kg == 0.7


def test_designs_are_analysed_by_what_they_can_tell() -> None:
    study = planned(candidates=PLAN["candidates"] | {"masses_kg": [[0.7], [0.5, 1.0]]})
    formulas = [case.model.formula.K for case in study.cases]
    assert formulas[0] == formulas[1] == "side + (1|subject) + (1|subject:side)"
    assert "log(mass_kg)" in formulas[2]
    assert study.cases[2].model is study.cases[3].model is not study.cases[0].model


def test_questions_about_what_the_design_lacks_are_refused_together() -> None:
    questions = {"side": "K[side=left] > 1", "level": "sd_subjct_K < 1", "slip": "K >", "number": "K + 1"}
    with pytest.raises(InputError) as caught:
        planned(candidates={"people": 10, "masses_kg": [0.5, 1.0]}, questions=questions)
    words = str(caught.value)
    assert len(caught.value.problems) == 4
    for part in ("questions.side, column 3", "Near: sd_", "questions.slip", "expected a claim"):
        assert part in words


def test_reliability_may_be_asked() -> None:
    questions = {"icc": "ICC_C1_K > 0.9", "change": "relative_MDC95_R_K < 10", "person": "K[subject=new] > 1"}
    assert [goal.name for goal in planned(questions=questions).goals] == list(questions)


@pytest.mark.parametrize(
    ("element", "value", "expected"),
    [("maxwell", "maxwell", "kelvin_voigt"), ("kelvin_voigt", "runs/pilot", "without a discrepancy")],
)
def test_a_pilot_of_another_law_is_refused(monkeypatch, element, value, expected) -> None:
    """Of another element, or of the same beside a discrepancy."""
    posterior = xr.DataTree.from_dict({"posterior": xr.Dataset({"K_secant": ("impact", [2900.0])})})
    pilot = SimpleNamespace(specification=SimpleNamespace(element=element), posterior=posterior)
    monkeypatch.setattr(planned_study, "read_run", lambda path: pilot)
    problem = refused(pilot="runs/pilot")["pilot"]
    assert (problem.value, expected in problem.expected) == (value, True)


def test_factors_are_those_that_questions_name_by_two_levels() -> None:
    named = factors_named(["K[side=left] / K[side=right] > 1.1", "K[sex=f] > 1", "K >", "K[subject=new] > 1"])
    assert named == [SIDES]
