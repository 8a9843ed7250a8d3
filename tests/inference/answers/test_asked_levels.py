"""Questions and predictions at levels of a study with sides, whose levels nobody recorded among them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayestissue.base.errors import InputError
from bayestissue.inference.answers.evaluation import draws_of
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.law import NO_LAW, Law, moving, unfit_height
from bayestissue.inference.answers.meaning import beyond_notes
from bayestissue.inference.answers.predictions import predict, read_conditions
from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.study import Study, described_impacts
from bayestissue.mechanics.elements import outcomes
from bayestissue.model.hierarchy.levels import design_at
from cases import cases
from designs import contrasts, design_of, impacts, normal_draws
from study_with_sides import SHAPE, study_with_sides

FORMULA = "side + (1|subject/side)"
G = 9.80665


@pytest.fixture(scope="module")
def study() -> Study:
    return study_with_sides(FORMULA)


def answered(study: Study, question: str) -> dict[str, Any]:
    (row,) = ask(study, numbered([question])).to_dict("records")
    return row


@pytest.mark.parametrize(("question", "why"), cases(__file__, "refused"))
def test_what_can_not_be_asked_says_why(study: Study, question: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        ask(study, numbered([question]))


def test_what_the_response_does_not_depend_on_chooses_among_the_recorded(study: Study) -> None:
    one, own = (answered(study, text) for text in ("mean(K[subject, age=23])", "K[subject=s1]"))
    assert one["median"] == own["median"]
    assert answered(study, "K[subject=new, side=left]")["median"] > 0


def at(study: Study, table: pd.DataFrame) -> pd.DataFrame:
    return predict(study, read_conditions(table, study))


def test_a_number_beyond_the_measured_and_an_average_are_noted(study: Study) -> None:
    average, named = (answered(study, text) for text in ("K[subject=s1]", "K[subject=s1, side=left] > 0"))
    assert average["note"] == "averaged over side, each level with equal weight"
    assert named["note"].startswith("no prior")
    assert "velocity_m_s beyond those measured" in answered(study, "peak_force[velocity_m_s=9]")["note"]


@pytest.mark.parametrize(
    ("velocity", "beyond"), [(1.534, False), (1.533, True), (1.981, False), (1.982, True)]
)
def test_a_number_as_tables_print_it_is_not_beyond_itself(velocity: float, beyond: bool) -> None:
    """Of drops from 12 and 20 cm, 1.53414 and 1.98057 m/s, tables print four digits."""
    heights = np.resize([0.12, 0.2], len(impacts()))
    design = design_of("1", rows=impacts().assign(velocity_m_s=np.sqrt(2 * 9.80665 * heights)))
    notes = beyond_notes(design.recorded, {"velocity_m_s": velocity})
    assert notes == (["velocity_m_s beyond those measured, 1.534 to 1.981, by 0.001"] if beyond else [])


@pytest.mark.slow
def test_a_person_on_a_side_that_was_not_recorded_has_a_new_effect_of_that_side(study: Study) -> None:
    sides = pd.DataFrame({"subject": ["s0", "s0"], "side": ["right", "left"], "velocity_m_s": [1.5, 1.5]})
    right, left = at(study, sides).to_dict("records")
    assert right["new"] == "subject:side"
    assert left["new"] == ""
    widths = [np.log(row["K_N_per_m_high"] / row["K_N_per_m_low"]) / 2 / 1.645 for row in (left, right)]
    # What side effects, known or new, the impact's own scatter and the rest make: 0.2 each beside 0.1.
    # With so many draws each end of an interval errs by 0.15 standard deviations: 3 * 0.064 of its width.
    assert widths[1] == pytest.approx(np.sqrt(0.05**2 + 0.2**2 + 0.2**2 + 0.1**2), rel=0.2)
    with pytest.raises(InputError, match="one of left, right"):
        read_conditions(sides.assign(side="rechts"), study)


def test_a_person_who_was_not_measured_is_asked_about(study: Study) -> None:
    notes = at(study, pd.DataFrame({"subject": ["s1O", "S1", "Eva", "new"], "side": "left"}))["note"]
    assert 'subject "s1O" was not measured: a new one of the population; did you mean s1?' in notes[0]
    # s1 in another case is s1.
    assert notes[1] == ""
    assert 'subject "Eva" was not measured: a new one of the population' in notes[2]
    assert "did you mean" not in notes[2]
    assert "was not measured" not in notes[3]


def test_columns_and_levels_are_found_whatever_their_case(study: Study) -> None:
    for text, meant in {
        "K[Side=LEFT, Patient=S1]": "K[side=left, subject=s1]",
        "best(SIDE, lowest K[subject=S2])": "best(side, lowest K[subject=s2])",
        "K_subject[Subject=S1] > 1000": "K_subject[subject=s1] > 1000",
        "mean(K[Subject])": "mean(K[subject])",
    }.items():
        found, expected = (ask(study, numbered([one])).drop(columns="question") for one in (text, meant))
        pd.testing.assert_frame_equal(found, expected)
    # So do the studies of a plan, which have only read the text.
    drawn = [draws_of(parse(text), study) for text in ("K[Side=LEFT]", "K[side=left]")]
    np.testing.assert_array_equal(*drawn)
    assert drawn[0].std() > 0
    rows = read_conditions(pd.DataFrame({"Patient": ["S1", "s9"], "SIDE": ["Left", "RIGHT"]}), study)
    assert rows == [{"subject": "s1", "side": "left"}, {"subject": "s9", "side": "right"}]
    with pytest.raises(InputError, match='Is it "side"'):
        read_conditions(pd.DataFrame({"Sidee": ["left"]}), study)
    # Two columns that differ by case alone are no column.
    with pytest.raises(InputError, match="SIDE"):
        read_conditions(pd.DataFrame({"SIDE": ["left"], "Side": ["left"]}), study)


def test_what_all_impacts_of_a_level_share_goes_with_it_and_is_said() -> None:
    """Two sessions of each side: a session is that of its side, in a comparison as in an answer."""
    rows = impacts().assign(velocity_m_s=1.5)
    rows["session"] = np.where(rows["side"] == "left", 1, 3) + np.resize([0, 1], len(rows))
    design = design_of("side + (1|session)", "1", rows=rows)
    values = {"intercept_K": 7.0, "effect_of_side[right]_K": 0.3, "session_effect_K": [0, 0.1, 0.2, 0.3]}
    levels = {"session_effect_K": ("session", list("1234"))}
    draws = normal_draws(1, 0.0, values, SHAPE, **levels)
    found = contrasts(draws, design.recorded, ["K"], 0.1).set_index(["factor", "level", "against"])
    # All else equal is asked for by giving it.
    of = Study(draws, design.recorded)
    assert answered(of, "log(K[session=4 over 1])")["median"] == pytest.approx(0.6)
    assert answered(of, "log(K[session=4 over 1, side=left])")["median"] == pytest.approx(0.3)
    assert np.log(found["ratio"]["session", "4", "1"]) == pytest.approx(0.6)
    assert found["note"]["session", "4", "1"] == "also differs: side (right against left)"
    assert found["note"]["session", "2", "1"] == ""
    assert np.log(found["ratio"]["side", "left", "right"]) == pytest.approx(-0.3)


def K_and_C(study: Study, **condition: str) -> list[np.ndarray]:
    logs = (design_at(study.recorded, q, [condition]).log(study.draws) for q in ("K", "C"))
    return [np.exp(log).ravel() for log in logs]


def test_an_outcome_at_levels_is_that_of_their_K_and_C(study: Study) -> None:
    K, C = K_and_C(study, side="left")
    force = outcomes("kelvin_voigt", {"K": K, "C": C}, 5.0, 2.0)["peak_force"]
    row = answered(study, "peak_force[side=left, mass_kg=5, velocity_m_s=2]")
    assert_allclose([row["low"], row["median"], row["high"]], np.quantile(force, [0.05, 0.5, 0.95]))
    assert row["unit"] == "N"
    claim = answered(study, f"peak_force[side=left, mass_kg=5, velocity_m_s=2] < {np.median(force)}")
    assert claim["posterior"] == 0.5
    # Without brackets: a typical person, hit by the reference mass at the mean velocity.
    K, C = K_and_C(study)
    reference = outcomes("kelvin_voigt", {"K": K, "C": C}, study.recorded.reference_mass_kg, 1.5)
    assert_allclose(answered(study, "peak_depth")["median"], np.median(reference["peak_depth"]))


def test_a_row_may_give_a_height_in_place_of_a_velocity(study: Study) -> None:
    along = replace(study, law=Law(gravity=G))
    heights = pd.DataFrame({"side": "left", "drop_height_cm": [12.0, 30.0, np.nan]})
    velocities = heights.assign(velocity_m_s=[*np.sqrt(2 * G * np.array([0.12, 0.3])), 1.5])
    velocities = velocities.drop(columns="drop_height_cm")
    columns = ["velocity_m_s", "peak_force_N", "peak_displacement_m_low", "energy_absorbed_J_high"]
    fallen, thrown = (at(along, table)[columns] for table in (heights, velocities))
    assert_allclose(fallen, thrown)
    # Of a rail that slopes by 30 degrees h is how much lower the impact is.
    assert moving({"drop_height_cm": 12.0}, G / 2)["velocity_m_s"] == pytest.approx(np.sqrt(2 * G * 0.12))


def test_heights_that_can_not_be_are_refused_at_once(study: Study) -> None:
    table = pd.DataFrame({"velocity_m_s": [np.nan, np.nan, 2.0], "drop_height_cm": [0.0, -3.0, 30.0]})
    with pytest.raises(InputError) as caught:
        at(replace(study, law=Law(gravity=G)), table)
    told = "; ".join(map(str, caught.value.problems))
    for row, value, expected in (
        (0, "0", "a number of cm above 0"),
        (1, "-3", "a number of cm above 0"),
        (2, "30", "drop_height_cm or velocity_m_s, not both"),
    ):
        assert f'row {row}, column drop_height_cm: found "{value}"; expected {expected}' in told
    with pytest.raises(InputError, match=r'row 1.*found "30".*velocity_m_s in its place, since this dataset'):
        at(study, pd.DataFrame({"drop_height_cm": [np.nan, 30.0]}))


def test_without_gravity_a_height_is_a_covariate_or_nothing(study: Study) -> None:
    """Of a pendulum whose K a formula has by its height, a height moves K, and the velocity is given."""
    rows = impacts().assign(velocity_m_s=1.5, drop_height_cm=np.resize([12.0, 20.0], len(impacts())))
    recorded = design_of("log(drop_height_cm) + (1|subject)", "1", rows=rows).recorded
    assert unfit_height(recorded, ["drop_height_cm"], 0.0).startswith("velocity_m_s beside it")
    assert unfit_height(recorded, ["drop_height_cm", "velocity_m_s"], 0.0) == ""
    unused = replace(recorded, formulas={"K": "1", "C": "1"})
    in_place = unfit_height(unused, ["drop_height_cm", "velocity_m_s"], 0.0)
    assert in_place.startswith("velocity_m_s in its place")
    # A height in another unit would change nothing.
    other = replace(unused, rows=rows.rename(columns={"drop_height_cm": "drop_height_mm"}))
    along = replace(study, recorded=other, law=Law(gravity=G))
    with pytest.raises(InputError, match=r'column drop_height_mm.*Is it "drop_height_cm"'):
        read_conditions(pd.DataFrame({"drop_height_mm": [300.0]}), along)


def test_a_velocity_that_a_formula_is_of_is_that_after_the_fall(study: Study) -> None:
    rows = impacts().assign(velocity_m_s=np.resize([1.5, 2.0], len(impacts())))
    design = design_of("log(velocity_m_s)", "1", rows=rows)
    values = {"intercept_K": 7.0, "intercept_C": 3.0, "effect_of_log(velocity_m_s)_K": 1.0}
    finished = Study(normal_draws(1, 0.0, values, SHAPE), design.recorded, Law(gravity=G))
    V = float(np.sqrt(2 * G * 0.2))
    by_height, by_velocity = (
        answered(finished, f"peak_force[mass_kg=1, {motion}]")["median"]
        for motion in ("drop_height_cm=20", f"velocity_m_s={V}")
    )
    assert by_height == pytest.approx(by_velocity, rel=1e-12)


def test_what_a_height_leads_beyond_is_said_with_by_how_much(study: Study) -> None:
    along = replace(study, law=Law(gravity=G))
    velocity = "velocity_m_s beyond those measured, 1.5 to 1.5, by 0.93"
    assert velocity in at(along, pd.DataFrame({"drop_height_cm": [30.0]}))["note"][0]
    assert velocity in answered(along, "peak_force[drop_height_cm=30]")["note"]


def test_a_depth_that_no_impact_at_these_levels_reached_is_said(study: Study) -> None:
    """Impacts on the right went deeper than any will on the left, where it is beyond those on the left."""
    left = study.recorded.labels("side") == "left"
    depths = np.where(left, 4e-4, 4e-3) + np.zeros((*SHAPE, len(left)))
    posterior = study.draws.assign(peak_depth=(("chain", "draw", "impact"), depths))
    measured = replace(study, draws=posterior)
    sides = [{"velocity_m_s": 1.5, "side": side} for side in ("left", "right")]
    on_left, on_right = predict(measured, sides).to_dict("records")
    over = float(f"{1e3 * on_left['peak_displacement_m']:.4g}") - 0.4
    assert over > 0.5
    assert f"peak depth in mm beyond those measured, 0 to 0.4, by {over:.2g}" in on_left["note"]
    assert "peak depth" not in on_right["note"]
    note = answered(measured, "peak_force[velocity_m_s=1.5, side=left]")["note"]
    assert "peak depth in mm beyond those measured, 0 to 0.4, by " in note
    for shallow in ("peak_force[velocity_m_s=0.3, side=left]", "peak_force[velocity_m_s=1.5, side=right]"):
        assert "peak depth" not in answered(measured, shallow)["note"]


def beside_a_discrepancy(study: Study, share: np.ndarray) -> Study:
    """With so much of each impact's peak as discrepancy."""
    draws = np.broadcast_to(share, (*SHAPE, len(share)))
    posterior = study.draws.assign(discrepancy=(("chain", "draw", "impact"), draws))
    return replace(study, draws=posterior, law=Law(described=described_impacts(posterior)))


def test_beside_a_discrepancy_outcomes_stay_where_it_is_slight(study: Study) -> None:
    """A discrepancy of the right side alone: what the left comes to follows the element's law as before."""
    share = np.where(study.recorded.rows["side"] == "left", 0.001, 0.1)
    beside = beside_a_discrepancy(study, share)
    asked = numbered(
        ["peak_force[side=left, mass_kg=2]", "critical(velocity_m_s, peak_depth[side=left] < 0.01)"]
    )
    for column in ("median", "low", "high"):
        assert ask(beside, asked)[column].tolist() == ask(study, asked)[column].tolist()
    for text in ("peak_force[side=right]", "peak_force", "best(side, lowest peak_depth)"):
        with pytest.raises(InputError, match="levels at which a law of force holds: side left"):
            ask(beside, numbered([text]))
    with pytest.raises(InputError, match="beside a discrepancy there is no law"):
        ask(replace(study, law=Law(described=False)), numbered(["peak_force[mass_kg=5]"]))
    people = ask(beside, numbered(["best(subject, lowest peak_depth[side=left])"]))
    assert people["level"].tolist() == ["s0", "s1", "s2", "s3"]
    sides = [{"side": side, "velocity_m_s": 1.5} for side in ("left", "right")]
    left, right = predict(beside, sides).to_dict("records")
    assert left["peak_force_N"] == predict(study, sides)["peak_force_N"][0]
    assert np.isnan(right["peak_force_N"])
    assert (NO_LAW in left["note"], NO_LAW in right["note"]) == (False, True)
    # Of four people the three who have a law are compared, and the other is named.
    alone = beside_a_discrepancy(study, np.where(study.recorded.rows["subject"] == "s1", 0.1, 0.0))
    answers = ask(alone, numbered(["best(subject, lowest peak_depth)"]))
    assert answers["level"].tolist() == ["s0", "s2", "s3"]
    assert answers["note"].str.contains("no peaks: no law of subject s1").all()
