"""A force beside the deceleration in a plan: what it adds, and what no number of impacts adds to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from stand_in import kernel

import bayestissue as bt
from bayestissue.errors import InputError, Problem
from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.planning.analysis import study_of
from bayestissue.planning.assurance import Assessment, planner
from bayestissue.planning.information import without_nuisance
from bayestissue.planning.plan import Plan, carry_out
from bayestissue.planning.specification import plan_of
from bayestissue.planning.words import sensor_words
from bayestissue.report.plan_page import page_of
from bayestissue.simulation import Simulation, simulate

MASS_SD, GAIN_SD = 0.1, 0.02
ALONE, BOTH = "accelerometer alone", "accelerometer and load cell"
CHANNEL = {
    "name": "load cell",
    "quantity": "force",
    "place": "impactor",
    "noise_relative_to_peak": 0.005,
    "relative_gain_sd": GAIN_SD,
    "offset_sd_N": 0.5,
}
RECORDING = {
    "sampling_rate_hz": 5000.0,
    "noise_relative_to_peak": 0.005,
    "velocity_sd_m_s": 0.005,
    "relative_mass_sd": MASS_SD,
}
MASSES, SPREAD = [0.5, 1.0], 0.1
PLAN: dict[str, Any] = {
    "name": "pendulum",
    "candidates": {"people": 1, "masses_kg": MASSES, "repeats": 8},
    "formula": {"K": "1", "C": "1"},
    "recording": RECORDING,
    "channel": [CHANNEL],
    "population": {
        "intercept": {"K": np.log(3000), "C": np.log(25)},
        "sd_impact": {"K": SPREAD, "C": SPREAD},
    },
    "precision": {"stiffness": {"of": "K", "relative": 0.1}},
    "goal": {"studies": 100},
}


def refused(**changed: Any) -> dict[str | None, Problem]:
    """The problems of the plan with other tables, by column."""
    with pytest.raises(InputError) as caught:
        study_of(plan_of(PLAN | changed, "plan.toml"), "plan.toml")
    return {problem.column: problem for problem in caught.value.problems}


def assessed(recorder: str, **kinds: Any) -> Assessment:
    """The stiffness in a hundred studies with some of the sensors."""
    study = study_of(plan_of(PLAN, "plan.toml"), "plan.toml")
    rows, chain = study.designs[0].rows(), study.simulations[recorder]
    ((one,),) = planner([rows], study.model_of(0), study.prior, chain, one_factor=True, **kinds).assess(
        study.goals, range(1)
    )
    return one


@pytest.fixture(scope="module")
def by_sensors() -> dict[str, Assessment]:
    return {recorder: assessed(recorder) for recorder in (ALONE, BOTH)}


def test_every_design_is_there_without_the_channel_and_with_it() -> None:
    plan = plan_of(PLAN, "plan.toml")
    forces = {name: recording.force for name, recording in plan.recordings.items()}
    assert forces == {ALONE: None, BOTH: plan.channel[0]}
    assert [design.recorder for design in study_of(plan, "plan.toml").designs] == [ALONE, BOTH]
    recorders = [{"name": name, "noise_sd_m_s2": 1.0, "relative_mass_sd": 0.1} for name in ("phone", "lab")]
    several = {name: table for name, table in PLAN.items() if name != "recording"} | {
        "candidates": {**PLAN["candidates"], "recorders": recorders}
    }
    assert list(plan_of(several, "plan.toml").recordings) == [
        *("phone alone", "phone and load cell"),
        *("lab alone", "lab and load cell"),
    ]


def test_a_channel_that_says_nothing_is_refused() -> None:
    assert "noise_sd_N" in refused(channel=[CHANNEL | {"noise_relative_to_peak": 0.0}])["channel.0"].expected
    assert "force" in refused(channel=[CHANNEL | {"quantity": "velocity"}])["channel.0.quantity"].expected
    exact = refused(recording=RECORDING | {"relative_mass_sd": 0.0})[None]
    assert "relative_mass_sd above 0" in exact.expected
    force = {"noise_sd_N": 1.0}
    assert "either [[channel]]" in refused(recording=RECORDING | {"force": force})[None].expected
    begun = refused(after={"run": "run", "dataset": "drops"})[None]
    assert "only without [after]" in begun.expected


def test_an_analysis_that_takes_no_force_is_refused_before_any_work(tmp_path: Path) -> None:
    (model := tmp_path / "wider.toml").write_text('like = "impact"\ndiscrepancy = "always"\n')
    problem = refused(model=str(model))["channel"]
    assert problem.code == "impossible-plan"
    assert "the model has a discrepancy" in problem.expected


def test_a_force_is_planned_behind_a_low_pass_too() -> None:
    study = study_of(plan_of(PLAN | {"recorder": {"low_pass_hz": 400.0}}, "plan.toml"), "plan.toml")
    rows, chain = study.designs[0].rows(), study.simulations[BOTH]
    known = planner([rows], study.model_of(0), study.prior, chain, one_factor=True).information
    conditions, people, size, _ = known.precision.shape
    assert size == 3
    # A mean of squares of that many standard normals.
    assert abs(known.calibration - 1) < 3 * np.sqrt(2 / (conditions * people * size))


def test_the_ratio_of_a_force_is_kept_and_the_rest_integrated_out() -> None:
    """Of a normal the marginal precision is the inverse of the covariance's part."""
    random = np.random.default_rng(0)
    root = random.standard_normal((3, 6, 6))
    precision = root @ np.swapaxes(root, 1, 2) + np.eye(6)
    centre, spread = random.standard_normal((3, 6)), np.array([0.3, 0.5, 0.2, 0.03])
    sites = GaussianFactor(centre, np.zeros((3, 6)), precision, np.zeros(3))
    with_prior = precision + np.diag([0, 0, *spread[:3] ** -2.0, 0])
    kept = [0, 1, 5]
    of_kept, P = without_nuisance(sites, spread, ratio=True)
    np.testing.assert_allclose(of_kept, centre[:, kept], rtol=1e-12)
    covariance = np.linalg.inv(with_prior)[:, kept][:, :, kept]
    np.testing.assert_allclose(P, np.linalg.inv(covariance), rtol=1e-9)


@pytest.mark.slow
def test_intervals_hold_the_truth_with_one_sensor_and_with_two(by_sensors: dict[str, Assessment]) -> None:
    for one in by_sensors.values():
        held = (np.abs(np.log(one.estimate / one.value)) < np.log1p(one.width)).mean()
        assert abs(held - 0.9) < 3 * np.sqrt(0.9 * 0.1 / one.studies)


@pytest.mark.slow
def test_no_number_of_impacts_beats_what_is_declared(by_sensors: dict[str, Assessment]) -> None:
    """The error of log mass is N(0, m²) with one sensor, and with two of variance m² g² / (m² + g²)."""
    both = MASS_SD * GAIN_SD / np.hypot(MASS_SD, GAIN_SD)
    for recorder, sd in ((ALONE, MASS_SD), (BOTH, both)):
        least = assessed(recorder, unlimited=True)
        np.testing.assert_allclose(least.width, np.exp(norm.ppf(0.95) * sd) - 1, rtol=0.01)
        assert by_sensors[recorder].width.min() > 0.98 * least.width.max()
    # With 16 impacts that scatter by 10 % two sensors are near the end of what impacts can do.
    expected = np.expm1(norm.ppf(0.95) * np.hypot(both, SPREAD / np.sqrt(16)))
    assert by_sensors[BOTH].width.mean() == pytest.approx(expected, rel=0.15)


@pytest.mark.slow
def test_fits_of_simulated_studies_with_a_force_are_as_sure_as_the_plan_says(
    by_sensors: dict[str, Assessment],
) -> None:
    chain = study_of(plan_of(PLAN, "plan.toml"), "plan.toml").simulations[BOTH].recording
    conditions = [{"trial": f"m{mass}", "mass_kg": mass, "velocity_m_s": 1.5} for mass in MASSES]
    widths = []
    for seed in range(4):
        factor = float(np.exp(MASS_SD * np.random.default_rng(seed).standard_normal()))
        recording = chain.model_copy(update={"relative_mass_sd": 0.0, "mass_factor": factor})
        simulation = Simulation.model_validate(
            {
                "name": "drops",
                "seed": seed,
                "design": {"subjects": 1, "repeats": 8, "conditions": conditions},
                "tissue": {
                    "K_N_per_m": 3000.0,
                    "C_N_s_per_m": 25.0,
                    "sd_impact_K": SPREAD,
                    "sd_impact_C": SPREAD,
                },
                "recording": recording.model_dump(),
            }
        )
        made = simulate(simulation).dataset("drops")
        declared = replace(made.uncertainty, relative_mass_sd=MASS_SD)
        answer = (
            bt.fit(replace(made, uncertainty=declared), "impact", K="1", C="1", seed=seed).ask("K").iloc[0]
        )
        widths.append(np.sqrt(answer["high"] / answer["low"]) - 1)
    planned = by_sensors[BOTH].width
    error = np.hypot(planned.std(), np.std(widths, ddof=1)) / np.sqrt(len(widths))
    assert abs(np.mean(widths) - planned.mean()) < 3 * error


def carried_out(limited: float | None, **candidates: Any) -> Plan:
    """The plan by the stand-in, whose designs with one sensor answer no more than so often."""
    lists = {"people": 1, "masses_kg": MASSES, "repeats": [20, 40, 80, 100]} | candidates
    with kernel(one_sensor=limited):
        return carry_out(study_of(plan_of(PLAN | {"candidates": lists}, "plan.toml"), "plan.toml"))


def test_what_a_second_sensor_saves_is_said() -> None:
    reached: dict[str, Any] = {"reaches": True, "unlimited": {}}
    sensors = [
        {"recorder": recorder, "force": recorder == BOTH, "design": number, **reached}
        for number, recorder in enumerate((ALONE, BOTH), start=1)
    ]
    plan = {"channel": [CHANNEL], "questions": {}, "goal": {"assurance": 0.8}}
    for impacts, worth in (((24, 8), "16 impacts of 24"), ((8, 8), "no impacts")):
        designs = [{"impacts": n, "recorder": name} for n, name in zip(impacts, (ALONE, BOTH), strict=True)]
        words = sensor_words({"plan": plan, "designs": designs, "sensors": sensors})
        assert words == [
            f"With accelerometer alone it takes {impacts[0]} impacts.",
            f"With accelerometer and load cell it takes {impacts[1]} impacts.",
            f"The second sensor saves {worth}.",
        ]


def test_the_mass_is_not_blamed_for_what_exact_masses_leave() -> None:
    goal = {"answered": 0.1, "undecided": 0.9, "width": 0.3}
    sensors = [
        {
            "recorder": "",
            "force": True,
            "design": 1,
            "reaches": False,
            "unlimited": {"new": goal},
            "exact": {},
        }
    ]
    precision = {"new": {"of": "K[subject=new]", "relative": 0.1}}
    plan = {"questions": {}, "precision": precision, "goal": {"assurance": 0.8}}
    content = {"plan": plan, "designs": [{"impacts": 40, "recorder": ""}], "sensors": sensors}
    for answered, words in ((0.1, "more than the 40 impacts"), (1.0, "mass and gains alone leaves ± 30")):
        sensors[0]["exact"] = {"new": goal | {"answered": answered}}
        (sentence,) = sensor_words(content)
        assert words in sentence


def test_what_no_number_of_impacts_reaches_is_said() -> None:
    plan = carried_out(0.5)
    assert (
        "With accelerometer alone no number of impacts is enough: what is declared of the mass alone"
        in plan.answer
    )
    assert "of K (wanted: ± 10\N{NO-BREAK SPACE}%)." in plan.answer
    assert "With accelerometer and load cell it takes 160 impacts." in plan.answer
    assert "saves" not in plan.answer
    page = page_of(plan.content, plan.designs, plan.about)
    assert "One sensor or two?" in page
    assert "What any number of impacts comes to" in page


def test_more_impacts_than_the_designs_have_may_be_needed() -> None:
    answer = carried_out(None, repeats=[20, 40]).answer
    assert "With accelerometer alone it takes more than the 80 impacts of these designs." in answer
