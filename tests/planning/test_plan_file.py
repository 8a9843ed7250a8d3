"""The plan file: what it may say, and that everything wrong is named before any work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from bayestissue.base.errors import InputError, Problem
from bayestissue.studies.planning import planned_study
from bayestissue.studies.planning.plan_file import plan_of, read_plan
from bayestissue.studies.planning.planned_study import factors_named, study_of

SIDES = {"name": "side", "levels": ["left", "right"]}
PLAN: dict[str, Any] = {
    "candidates": {"people": [10, 20], "masses_kg": [0.5, 1.0], "repeats": [2], "factors": [SIDES]},
    "questions": {"left": "K[side=left] / K[side=right] > 1.1"},
}
MASS = {"people": 10, "masses_kg": [0.5, 1.0]}


def refused(**changed: Any) -> dict[str | None, Problem]:
    """The problems of the plan with other tables, by key."""
    with pytest.raises(InputError) as caught:
        study_of(plan_of(PLAN | changed, "plan.toml"), "plan.toml")
    return {problem.column: problem for problem in caught.value.problems}


def test_a_file_is_read_and_called_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "sides.toml"
    path.write_text(
        '[candidates]\npeople = 8\nmasses_kg = [0.5, 1]\n[questions]\na = "mass_exponent_K < 0.5"\n'
    )
    plan = read_plan(path)
    assert (plan.name, plan.model, plan.goal.studies, plan.candidates.people) == (
        "sides",
        "impact",
        500,
        (8,),
    )


def test_everything_wrong_is_named_at_once() -> None:
    problems = refused(
        candidates={"people": [0], "masses_kg": [0.5, -1], "person": 3},
        cost={"person_min": -1},
        goal={"assurance": 1, "studies": 77},
        precision={"width": {"of": "K", "half_width": 1, "relative": 0.2}},
    )
    assert {
        "candidates.people.0",
        "candidates.masses_kg.0.1",
        "candidates.person",
        "cost.person_min",
        "goal.assurance",
        "goal.studies",
        "precision.width",
    } <= set(problems)
    assert "people, masses_kg" in problems["candidates.person"].expected
    assert "greater than or equal to 0" in problems["cost.person_min"].expected


def test_a_plan_that_asks_nothing_or_hits_nobody_is_refused() -> None:
    assert "[questions]" in refused(questions={})[None].expected
    assert "masses_kg" in refused(candidates={"people": 3})["candidates"].expected
    many = {"people": list(range(1, 400)), "masses_kg": [[0.5], [1.0]]}
    assert "at most 500 designs" in refused(candidates=many)["candidates"].expected


def test_wrong_recorders_are_named() -> None:
    good, silent = {"name": "phone", "noise_sd_m_s2": 1.0}, {"name": "lab", "bit": 3}
    problems = refused(candidates={**MASS, "recorders": [good, silent]})
    assert "bits" in problems["candidates.recorders.1.bit"].expected
    problems = refused(candidates={**MASS, "recorders": [good, {"name": "lab"}]})
    assert "noise_sd_m_s2" in problems["candidates.recorders.1"].expected
    twice = refused(candidates={**MASS, "recorders": [good, good]})["candidates"]
    assert "a different name of each recorder" in twice.expected
    both = refused(candidates={**MASS, "recorders": [good]}, recording={"noise_sd_m_s2": 1.0})[None]
    assert "either [recording] or [[candidates.recorders]]" in both.expected


@pytest.mark.parametrize("levels", [["left", ""], ["left", " "], ["left", "left"]])
def test_levels_of_a_factor_have_a_name_each(levels: list[str]) -> None:
    factors = [SIDES | {"levels": levels}]
    problem = refused(candidates={**MASS, "factors": factors})["candidates.factors.0.levels"]
    assert problem.expected.startswith("levels with a name each")
    assert problem.value == levels


def test_the_default_formula_has_the_factors_that_are_asked_for() -> None:
    study = study_of(plan_of(PLAN, "plan.toml"), "plan.toml")
    formula = study.cases[0].model.formula
    assert formula.K == formula.C == "log(mass_kg) + side + (1|subject) + (1|trial) + (1|subject:side)"
    assert study.cases[0].model is study.cases[1].model
    assert study.cases[0].model.reference_mass_kg == 0.7


def test_questions_name_a_factor_in_any_case() -> None:
    factor = {"name": "Side", "levels": ["left", "right"]}
    content = PLAN | {"candidates": {**PLAN["candidates"], "factors": [factor]}}
    formula = study_of(plan_of(content, "plan.toml"), "plan.toml").cases[0].model.formula
    assert formula.K == "log(mass_kg) + Side + (1|subject) + (1|trial) + (1|subject:Side)"


def test_a_group_of_people_has_no_effects_within_a_person() -> None:
    sex = {"name": "sex", "levels": ["f", "m"], "of_people": True}
    content = PLAN | {
        "candidates": {**PLAN["candidates"], "factors": [sex]},
        "questions": {"a": "K[sex=f] < K[sex=m]"},
    }
    study = study_of(plan_of(content, "plan.toml"), "plan.toml")
    assert study.cases[0].model.formula.K == "log(mass_kg) + sex + (1|subject) + (1|trial)"


def test_designs_are_analysed_by_what_they_can_tell() -> None:
    content = PLAN | {"candidates": {**PLAN["candidates"], "masses_kg": [[0.7], [0.5, 1.0]]}}
    study = study_of(plan_of(content, "plan.toml"), "plan.toml")
    formulas = [case.model.formula.K for case in study.cases]
    assert formulas[0] == formulas[1] == "side + (1|subject) + (1|subject:side)"
    assert "log(mass_kg)" in formulas[2]
    assert study.cases[2].model is study.cases[3].model is not study.cases[0].model


def test_an_exponent_is_not_asked_where_no_mass_varies() -> None:
    problems = refused(
        candidates={**MASS, "masses_kg": [[0.7], [0.5, 1.0]]}, questions={"beta": "mass_exponent_K < 0.5"}
    )
    problem = problems["candidates.masses_kg"]
    assert problem.value == 0.7
    assert "since beta asks for mass_exponent_K" in problem.expected


def test_questions_about_what_the_design_lacks_are_refused_together() -> None:
    questions = {"side": "K[side=left] > 1", "level": "sd_subjct_K < 1", "slip": "K >", "number": "K + 1"}
    plan = plan_of(PLAN | {"candidates": MASS, "questions": questions}, "plan.toml")
    with pytest.raises(InputError) as caught:
        study_of(plan, "plan.toml")
    words = str(caught.value)
    assert len(caught.value.problems) == 4
    for part in ("questions.side, column 3", "Near: sd_", "questions.slip", "expected a claim"):
        assert part in words


def test_a_precision_is_of_a_number_and_relative_to_no_zero() -> None:
    problems = refused(
        precision={
            "claim": {"of": "K > 1", "relative": 0.2},
            "exponent": {"of": "mass_exponent_K", "relative": 0.2},
        }
    )
    assert "no claim" in problems["precision.claim.of"].expected
    assert "half_width" in problems["precision.exponent.relative"].expected


def test_reliability_may_be_asked() -> None:
    questions = {"icc": "ICC_C1_K > 0.9", "change": "relative_MDC95_R_K < 10", "person": "K[subject=new] > 1"}
    goals = study_of(plan_of(PLAN | {"questions": questions}, "plan.toml"), "plan.toml").goals
    assert [goal.name for goal in goals] == list(questions)


def test_beliefs_about_effects_that_no_formula_has_are_refused() -> None:
    population = {
        "effects": {"K": {"side[rigt]": 0.1, "side[right]": 0.1}},
        "sd_group": {"subject:session": {"K": 0.1, "C": 0.1}},
    }
    problems = refused(population=population)
    assert set(problems) == {'population.effects.K."side[rigt]"', 'population.sd_group."subject:session"'}
    assert "side[right]" in problems['population.effects.K."side[rigt]"'].expected


def test_formulas_are_judged_on_the_designs() -> None:
    problems = refused(formula={"K": "log(mass_kg) + sex + (1|subject)"}, questions={"a": "K > 2000"})
    assert "there is no column sex" in problems["formula.K"].remedy


def test_a_model_of_displacements_is_refused() -> None:
    assert "impact" in refused(model="arma")["model"].expected


def test_a_pilot_of_another_element_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Pilot:
        class specification:  # noqa: N801 - as `Fit` has it
            element = "maxwell"

    monkeypatch.setattr(planned_study, "read_run", lambda path: Pilot)
    problem = refused(pilot="runs/pilot")["pilot"]
    assert (problem.value, "kelvin_voigt" in problem.expected) == ("maxwell", True)


def test_a_pilot_with_a_discrepancy_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Pilot:
        class specification:  # noqa: N801 - as `Fit` has it
            element = "kelvin_voigt"

        posterior = xr.DataTree.from_dict({"posterior": xr.Dataset({"K_secant": ("impact", [2900.0])})})

    monkeypatch.setattr(planned_study, "read_run", lambda path: Pilot)
    problem = refused(pilot="runs/pilot")["pilot"]
    assert (problem.value, "without a discrepancy" in problem.expected) == ("runs/pilot", True)


def test_a_pilot_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run\.json"):
        study_of(plan_of(PLAN | {"pilot": str(tmp_path)}, "plan.toml"), "plan.toml")


def test_factors_are_those_that_questions_name_by_two_levels() -> None:
    named = factors_named(["K[side=left] / K[side=right] > 1.1", "K[sex=f] > 1", "K >", "K[subject=new] > 1"])
    assert named == [SIDES]


def test_a_second_sensor_is_refused_with_what_to_do() -> None:
    force = {"noise_sd_N": 1.0}
    recorders = [{"name": "cell", "noise_sd_m_s2": 0.1, "force": force}]
    content = {
        "candidates": {"people": 2, "masses_kg": [1.0], "recorders": recorders},
        "channel": [{"name": "load cell", "quantity": "force"}],
        "questions": {"stiff": "K > 1000"},
    }
    with pytest.raises(InputError) as caught:
        plan_of(content, "plan.toml")
    told = {problem.column: problem for problem in caught.value.problems}
    assert set(told) == {"channel", "candidates.recorders.0.force"}
    assert {problem.code for problem in told.values()} == {"retired"}
    alone = {"people": 2, "masses_kg": [1.0]}
    recording = {"noise_sd_m_s2": 0.1, "force": force}
    with pytest.raises(InputError, match="designs are planned for the deceleration alone"):
        plan_of({**content, "candidates": alone, "recording": recording}, "plan.toml")
