from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.base.results.tables import columns_of
from bayestissue.inference.answers.contrasts import ALL
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.meaning import draws_of as draws_at
from bayestissue.inference.answers.meaning import mistakes
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.model.hierarchy.recorded import Recorded
from designs import REFERENCE, contrasts, impacts

SHAPE = (2, 500)


def recorded(formula: str, rows: pd.DataFrame | None = None) -> Recorded:
    table = (impacts() if rows is None else rows).assign(velocity_m_s=1.5)
    return Recorded(table.drop(columns="impact"), {"K": formula}, REFERENCE)


def draws_of(rng: np.random.Generator, sd: float, values: Mapping[str, float | list[float]], **levels):
    """Independent normal draws about ``values``, those of a list along the dimension of ``levels``."""
    found = {}
    for name, value in values.items():
        at = np.asarray(value, float)
        dims = ("chain", "draw", *([levels[name][0]] if name in levels else []))
        found[name] = (dims, at + sd * rng.standard_normal((*SHAPE, *at.shape)))
    return xr.Dataset(found, dict(levels.values()))


def rows_of(table: pd.DataFrame, factor: str) -> dict[tuple[str, str], pd.Series]:
    own = table[table["factor"] == factor]
    return {(row["level"], row["against"]): row for _, row in own.iterrows()}


def test_a_ratio_with_its_interval_and_probabilities_is_that_of_the_draws() -> None:
    draws = draws_of(np.random.default_rng(1), 0.05, {"intercept_K": 7.0, "effect_of_side[right]_K": -0.08})
    found = contrasts(draws, recorded("side"), ["K"], 0.1)
    assert list(found) == columns_of("contrasts")
    # Left goes before right, which is the column that the formula has.
    log = -draws["effect_of_side[right]_K"].to_numpy().ravel()
    row = rows_of(found, "side")["left", "right"]
    assert len(found) == 1
    assert_allclose(row[["ratio", "low", "high"]].astype(float), np.exp(np.percentile(log, [50, 5, 95])))
    assert row["p_direction"] == (log > 0).mean()
    assert row["p_equivalent"] == (abs(log) < np.log(1.1)).mean()
    wider = contrasts(draws, recorded("side"), ["K"], 0.2)["p_equivalent"][0]
    assert wider == (abs(log) < np.log(1.2)).mean()
    assert contrasts(draws, recorded("log(mass_kg) + (1|subject)"), ["K"], 0.1).empty


def test_beside_a_discrepancy_ratios_of_k_are_the_element_s_and_people_have_their_secants() -> None:
    values = {"intercept_K": 7.0, "effect_of_side[right]_K": -0.08, "K_secant_of_impacts": 2000.0}
    values |= {"intercept_C": 3.0, "effect_of_side[right]_C": -0.08}
    rng = np.random.default_rng(1)
    draws, of = draws_of(rng, 0.05, values), recorded("side")
    both = Recorded(of.rows, {"K": "side", "C": "side"}, REFERENCE)
    notes = contrasts(draws, both, ["K", "C"], 0.1).set_index("quantity")["note"]
    assert notes.to_dict() == {"K": ELEMENT_ALONE, "C": ""}


def test_what_interacts_with_a_factor_is_averaged() -> None:
    values = {"intercept_K": 7.0, "effect_of_side[right]_K": -0.1, "mass_exponent_K": 0.0}
    values |= {"effect_of_operator[y]_K": 0.3, "effect_of_side[right]:operator[y]_K": -0.2}
    draws = draws_of(np.random.default_rng(2), 0.0, values)
    found = contrasts(draws, recorded("log(mass_kg) + side*operator"), ["K"], 0.1)
    assert rows_of(found, "side")["left", "right"]["ratio"] == pytest.approx(np.exp(0.1 + 0.2 / 2))
    # On the left 0.3 more by y, on the right 0.1.
    assert rows_of(found, "operator")["x", "y"]["ratio"] == pytest.approx(np.exp(-0.2))


def test_a_number_of_two_values_is_a_factor_and_a_mass_is_none() -> None:
    rows = impacts().assign(trained=lambda table: (table["subject"] > "s1").astype(int))
    draws = draws_of(
        np.random.default_rng(3),
        0.0,
        {"intercept_K": 7.0, "effect_of_trained_K": 0.2, "mass_exponent_K": 1.0},
    )
    two = rows[rows["mass_kg"] < 1]
    found = contrasts(draws, recorded("log(mass_kg) + trained", two), ["K"], 0.1)
    assert found[["factor", "level", "against"]].to_numpy().tolist() == [["trained", "1", "0"]]
    assert found["ratio"][0] == pytest.approx(np.exp(0.2))


def test_numbers_that_a_formula_takes_as_categories_are_compared() -> None:
    rows = impacts().assign(phase=lambda table: np.arange(len(table)) % 4 + 1)
    # The mean of the phases is none of them, and the first is the reference.
    values = {f"effect_of_C(phase)[{level}]_K": 0.1 * level for level in (2, 3, 4)}
    draws = draws_of(np.random.default_rng(7), 0.0, {"intercept_K": 7.0, **values})
    found = rows_of(contrasts(draws, recorded("C(phase)", rows), ["K"], 0.1), "phase")
    ratios = {pair: row["ratio"] for pair, row in found.items()}
    logs = {"1": 0.0, "2": 0.2, "3": 0.3, "4": 0.4}
    expected = [("4", "3"), ("4", "2"), ("4", "1"), ("3", "2"), ("3", "1"), ("2", "1")]
    assert ratios == pytest.approx({(a, b): np.exp(logs[a] - logs[b]) for a, b in expected})
    node = parse("mean(K[phase]) / K[phase=3] - K / K[phase=1]")
    of = recorded("C(phase)", rows)
    assert not list(mistakes(node, of, draws))
    # K alone is that of the four phases, averaged on the log scale.
    each = np.exp(np.array([0.0, 0.2, 0.3, 0.4]) - 0.3).mean()
    assert_allclose(draws_at(node, Study(draws, of)), each - np.exp(0.9 / 4))
    assert "a level of phase: 1, 2, 3, 4" in str(*mistakes(parse("K[phase=2.5]"), of, draws))


def test_groups_are_compared_in_pairs_and_many_levels_with_their_mean() -> None:
    effects = {"session_effect_K": [0.1, -0.1, 0.3]}
    draws = draws_of(
        *(np.random.default_rng(4), 0.0, {"intercept_K": 7.0, **effects}),
        session_effect_K=("session", impacts()["session"].astype(str).drop_duplicates().tolist()),
    )
    found = rows_of(contrasts(draws, recorded("(1|session)"), ["K"], 0.1), "session")
    own = draws["session_effect_K"].mean(("chain", "draw")).to_series()
    assert set(found) == {("3", "2"), ("3", "1"), ("2", "1")}
    assert found["3", "1"]["ratio"] == pytest.approx(np.exp(own["3"] - own["1"]))
    rows = impacts(people=13).assign(operator=lambda table: "o" + table["subject"])
    names = rows["operator"].drop_duplicates().tolist()
    many = draws_of(
        np.random.default_rng(5), 0.0,
        {"intercept_K": 7.0, "operator_effect_K": np.linspace(-0.3, 0.3, 13).tolist()},
        operator_effect_K=("operator", names),
    )  # fmt: skip
    found = rows_of(contrasts(many, recorded("(1|operator)", rows), ["K"], 0.1), "operator")
    assert {against for _, against in found} == {ALL}
    assert found["os12", ALL]["ratio"] == pytest.approx(np.exp(0.3))


def test_sides_are_compared_within_each_person_and_over_these_people() -> None:
    levels = [f"s{person}:{side}" for person in range(4) for side in ("left", "right")]
    effects = [0.1, 0.0, 0.2, 0.0, 0.3, 0.0, 0.0, 0.2]
    draws = draws_of(
        np.random.default_rng(6), 0.0, {"intercept_K": 7.0, "subject_side_effect_K": effects},
        subject_side_effect_K=("subject:side", levels),
    )  # fmt: skip
    table = contrasts(draws, recorded("(1|subject:side)"), ["K"], 0.1)
    own = rows_of(table, "subject:side")
    assert set(own) == {(f"s{p}:left", f"s{p}:right") for p in range(4)}
    assert own["s3:left", "s3:right"]["ratio"] == pytest.approx(np.exp(-0.2))
    assert rows_of(table, "side")["left", "right"]["ratio"] == pytest.approx(np.exp(0.4 / 4))
    # The covariate's own contrast is the population's, and a person's holds it too.
    both = draws.assign({"effect_of_side[right]_K": (("chain", "draw"), np.full(SHAPE, -0.5))})
    table = contrasts(both, recorded("side + (1|subject:side)"), ["K"], 0.1)
    assert rows_of(table, "side")["left", "right"]["ratio"] == pytest.approx(np.exp(0.5))
    assert rows_of(table, "subject:side")["s3:left", "s3:right"]["ratio"] == pytest.approx(np.exp(0.3))


def test_conditions_are_compared_at_one_mass_only_where_the_mass_is_in_the_formula() -> None:
    rows = pd.concat([impacts().assign(tense=0), impacts().assign(tense=1)], ignore_index=True)
    rows["trial"] += np.where(rows["tense"], "-tense", "")
    names = rows["trial"].drop_duplicates().tolist()
    draws = draws_of(
        np.random.default_rng(7), 0.0,
        {"intercept_K": 7.0, "mass_exponent_K": 1.0, "trial_effect_K": [0, 0, 0.1, 0.2, 0, 0]},
        trial_effect_K=("trial", names),
    )  # fmt: skip
    with_mass = contrasts(draws, recorded("log(mass_kg) + (1|trial)", rows), ["K"], 0.1)
    assert set(rows_of(with_mass, "trial")) == {(f"t{i}", f"t{i}-tense") for i in range(3)}
    assert rows_of(with_mass, "trial")["t0", "t0-tense"]["ratio"] == pytest.approx(np.exp(-0.2))
    without = contrasts(draws, recorded("(1|trial)", rows), ["K"], 0.1)
    assert len(rows_of(without, "trial")) == 15
    assert contrasts(draws, recorded("log(mass_kg) + (1|trial)"), ["K"], 0.1).empty


GROUP_OF = {f"s{person}": "treated" if person % 2 else "control" for person in range(4)}
CLINIC = "group*session + side + weight + (1|subject) + (1|subject:side) + (1|subject:session)"


def clinic() -> tuple[Recorded, xr.Dataset, dict[str, float]]:
    """Two groups of two people, before and after, both sides, weighed at each visit; log ratios by hand."""
    rows = pd.DataFrame(
        [
            (person, group, session, side, 60.0 + place + 2 * (session == "after") * place, "t", 0.8)
            for place, (person, group) in enumerate(GROUP_OF.items())
            for session in ("before", "after")
            for side in ("left", "right")
            for _ in range(2)
        ],
        columns=["subject", "group", "session", "side", "weight", "trial", "mass_kg"],
    ).assign(velocity_m_s=1.5)
    rows["device"] = rows["session"].map({"before": "old", "after": "new"})
    visits = [f"{person}:{session}" for person in GROUP_OF for session in ("before", "after")]
    of_visits = np.linspace(-0.04, 0.05, len(visits))
    values = {"intercept_K": 7.0, "effect_of_group[treated]_K": 0.05, "effect_of_session[before]_K": 0.04}
    values |= {"effect_of_group[treated]:session[before]_K": -0.2, "effect_of_side[right]_K": 0.1}
    values |= {"effect_of_weight_K": 0.03, "subject_effect_K": [0.1, -0.1, 0.2, 0.0]}
    values |= {"subject_session_effect_K": of_visits.tolist(), "subject_side_effect_K": [0.0] * 8}
    draws = draws_of(
        *(np.random.default_rng(5), 0.0, values),
        subject_effect_K=("subject", list(GROUP_OF)),
        subject_session_effect_K=("subject:session", visits),
        subject_side_effect_K=("subject:side", [f"{p}:{s}" for p in GROUP_OF for s in ("left", "right")]),
    )
    own = dict(zip(visits, of_visits, strict=True))
    truth = {
        person: -0.04 + 0.2 * (group == "treated") + 0.03 * 2 * place
        + own[f"{person}:after"] - own[f"{person}:before"]
        for place, (person, group) in enumerate(GROUP_OF.items())
    }  # fmt: skip
    return Recorded(rows, {"K": CLINIC}, REFERENCE), draws, truth


def test_a_persons_before_and_after_is_of_the_persons_group_and_visits() -> None:
    known, draws, truth = clinic()
    table = contrasts(draws, known, ["K"], 0.1)
    own = rows_of(table, "subject:session")
    for person, log in truth.items():
        assert np.log(own[f"{person}:after", f"{person}:before"]["ratio"]) == pytest.approx(log)
        asked = draws_at(parse(f"log(K[subject={person}, session=after over before])"), Study(draws, known))
        assert_allclose(asked, log)
        assert own[f"{person}:after", f"{person}:before"]["kind"] == "combinations"


@pytest.mark.slow
def test_of_three_columns_the_change_of_the_treated_stands_at_each_side() -> None:
    cells = [
        (f"s{p}", group, session, side)
        for p, group in enumerate(["treated", "control"] * 2)
        for session in ("before", "after")
        for side in ("operated", "sound")
    ]
    rows = pd.DataFrame(cells, columns=["subject", "group", "session", "side"])
    rows = rows.assign(trial="t", mass_kg=0.5, impact=range(len(rows)))
    of = recorded("group*side*session", rows)
    draws = xr.Dataset({"intercept_K": (("chain", "draw"), np.full((1, 5), 7.0))})
    rng = np.random.default_rng(1)
    for name in of.response("K").evaluated.at(of.rows)[0]:
        draws[f"effect_of_{name}_K"] = (("chain", "draw"), rng.standard_normal((1, 5)))
    found = contrasts(draws.assign_coords(chain=[0], draw=range(5)), of, ["K"], 0.1)
    first = found[found["kind"] == "interaction"].head(2)
    assert first["factor"].tolist() == ["group:session:side"] * 2
    assert first["level"].tolist() == ["treated:after/before:operated", "treated:after/before:sound"]
    asked = "K[session=after over before, group=treated over control, side={}]"
    for side, ratio in zip(["operated", "sound"], first["ratio"], strict=True):
        assert_allclose(ratio, np.median(draws_at(parse(asked.format(side)), Study(draws, of))))


def test_an_interaction_is_a_contrast_and_has_a_short_form() -> None:
    known, draws, _ = clinic()
    table = contrasts(draws, known, ["K"], 0.1)
    (((level, against), row),) = rows_of(table, "group:session").items()
    assert (level, against, row["kind"]) == ("treated:after/before", "control:after/before", "interaction")
    assert np.log(row["ratio"]) == pytest.approx(0.2)
    short = "log(K[group=treated over control, session=after over before])"
    assert_allclose(draws_at(parse(short), Study(draws, known)), 0.2)
    # A reference stands below, and all of an average is of equal weight.
    assert np.log(rows_of(table, "session")["after", "before"]["ratio"]) == pytest.approx(-0.04 + 0.1)
    assert np.log(rows_of(table, "group")["treated", "control"]["ratio"]) == pytest.approx(0.05 - 0.1)


def test_what_changes_with_a_factor_is_noted_whether_a_formula_has_it_or_not() -> None:
    known, draws, _ = clinic()
    table = contrasts(draws, known, ["K"], 0.1)
    assert rows_of(table, "session")["after", "before"]["note"] == "also differs: device (new against old)"
    own = rows_of(table, "subject:session")["s2:after", "s2:before"]["note"]
    assert own == "also differs: weight (66 against 62), device (new against old)"
    assert rows_of(table, "side")["left", "right"]["note"] == ""
