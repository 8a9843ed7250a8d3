"""Outcomes in a plan: their law, what is refused, and their precision against what a study comes to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.constants import g
from scipy.stats import t

from bayestissue.base.errors import InputError, Problem
from bayestissue.mechanics.elements import outcomes
from bayestissue.studies.planning.assurance import Assessment, planner
from bayestissue.studies.planning.plan_file import plan_of
from bayestissue.studies.planning.planned_study import PlannedStudy, factors_named, study_of
from bayestissue.studies.planning.tabulated_law import PlannedLaw

MASS, HEIGHT = 5.0, 0.3
FORCE = "peak_force[mass_kg=5, drop_height_cm=30]"
VELOCITIES = [1.534, 1.981]
SPREAD = 0.2
PLAN: dict[str, Any] = {
    "candidates": {"people": 1, "masses_kg": MASS, "velocities_m_s": VELOCITIES, "repeats": [8, 24]},
    "gravity": "drop",
    "formula": {"K": "1", "C": "1"},
    "population": {
        "intercept": {"K": np.log(30_000), "C": np.log(150)},
        "sd_impact": {"K": SPREAD, "C": 0.1},
    },
    "precision": {"force": {"of": FORCE, "relative": 0.05}},
    "goal": {"studies": 100},
}


def planned(**changed: Any) -> PlannedStudy:
    return study_of(plan_of(PLAN | changed, "plan.toml"), "plan.toml")


def assessed(study: PlannedStudy) -> list[Assessment]:
    """Of each design the one goal, over the first block of studies."""
    first = study.cases[0]
    rows = [case.design.rows() for case in study.cases]
    ready = planner(rows, first.model, first.prior, first.simulation)
    return [of_goal for (of_goal,) in ready.assess(study.goals, range(1))]


def refused(**changed: Any) -> dict[str | None, Problem]:
    """The problems of the plan with other tables, by column."""
    with pytest.raises(InputError) as caught:
        planned(**changed)
    return {problem.column: problem for problem in caught.value.problems}


def test_an_outcome_is_asked_as_of_a_finished_fit() -> None:
    study = planned(questions={"safe": f"{FORCE} < 1500"})
    assert [goal.text for goal in study.goals] == [f"{FORCE} < 1500", FORCE]


def test_a_motion_is_no_factor() -> None:
    asked = ["peak_force[pad=A, drop_height_cm=30] < peak_force[pad=B, drop_height_cm=20]"]
    assert [factor["name"] for factor in factors_named(asked)] == ["pad"]


@pytest.mark.parametrize(
    ("question", "changed", "expected"),
    [
        (FORCE, {"gravity": "none"}, "velocity_m_s in its place"),
        ("HIC15[mass_kg=5, drop_height_cm=30]", {}, "headform = true"),
        ("peak_forse[mass_kg=5]", {}, "a quantity of this run"),
        ("critical(drop_height_cm, peak_force[mass_kg=5] < 1500)", {}, "a stated height or velocity"),
        (FORCE, {"model": "stiffening"}, "a plan does not draw stiffening_depth_m of stiffening"),
    ],
)
def test_what_a_plan_has_no_motion_for_is_refused(question, changed, expected) -> None:
    problems = refused(precision={"force": {"of": question, "relative": 0.05}}, **changed)
    assert expected in " ".join(problem.expected for problem in problems.values())


@pytest.mark.slow
def test_between_the_grid_an_outcome_is_its_law_s() -> None:
    rng = np.random.default_rng(0)
    # On both sides of borders between tiles, and where all are thrown back.
    log_K, log_C = rng.uniform(7.5, 9.5, 200), rng.uniform(3.2, 4.2, 200)
    V = np.sqrt(2 * g * HEIGHT)
    true = outcomes("kelvin_voigt", {"K": np.exp(log_K), "C": np.exp(log_C)}, MASS, V, gravity=g)
    law = PlannedLaw("kelvin_voigt", g)
    for name in ("peak_force", "peak_depth", "time_to_peak", "energy_absorbed"):
        values = law._interpolated(name, np.stack([log_K, log_C]), (MASS, V, 0.05))
        assert values == pytest.approx(np.asarray(true[name]), rel=4e-3), name


def test_a_time_that_never_comes_is_infinite() -> None:
    law = PlannedLaw("kelvin_voigt", g)
    at = np.log([[3000.0, 3000.0], [30.0, 3000.0]])
    leaves, stays = law._interpolated("contact_duration", at, (1.0, 1.5, 0.05))
    assert 0 < leaves < 1
    assert np.isinf(stays)


@pytest.mark.slow
def test_the_precision_of_a_force_is_that_of_its_posterior() -> None:
    """Of a spring ½ M V² + M g x = ½ K x²: F = M g + (M² g² + K M V²)^1/2, and log F moves as log K does.

    With n impacts of an unknown spread the 90 % interval of log K is that of Student's t, n - 1 degrees of
    freedom; of the spread the analysis believes little, which adds some per cent.
    """
    # So little damping that the force is the spring's.
    population = PLAN["population"] | {"intercept": {"K": np.log(30_000), "C": np.log(5)}}
    K, V2 = 30_000.0, 2 * g * HEIGHT
    root = np.sqrt((MASS * g) ** 2 + K * MASS * V2)
    slope = K * MASS * V2 / (2 * root * (MASS * g + root))
    for one, n in zip(assessed(planned(population=population)), (16, 48), strict=True):
        width = np.exp(slope * t.ppf(0.95, n - 1) * SPREAD / np.sqrt(n)) - 1
        assert one.table["width"].mean() == pytest.approx(width, rel=0.08)
