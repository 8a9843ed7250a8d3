from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from bayestissue.base.results.tables import columns_of
from bayestissue.inference.answers.contrasts import ALL
from bayestissue.inference.answers.evaluation import draws_of as draws_at
from bayestissue.inference.answers.grammar import parse
from bayestissue.inference.answers.meaning import mistakes
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.model.hierarchy.recorded import Recorded
from cases import cases
from designs import REFERENCE, contrasts, impacts, normal_draws

TERMS = {"session_effect_K": "session", "subject_side_effect_K": "subject:side", "trial_effect_K": "trial"}


def recorded(formula: str, rows: pd.DataFrame | None = None) -> Recorded:
    table = (impacts() if rows is None else rows).assign(velocity_m_s=1.5)
    return Recorded(table.drop(columns="impact"), {"K": formula}, REFERENCE)


def rows_of(table: pd.DataFrame, factor: str) -> dict[tuple[str, str], pd.Series]:
    own = table[table["factor"] == factor]
    return {(row["level"], row["against"]): row for _, row in own.iterrows()}


def test_a_ratio_with_its_interval_and_probabilities_is_that_of_the_draws() -> None:
    draws = normal_draws(1, 0.05, {"intercept_K": 7.0, "effect_of_side[right]_K": -0.08})
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
    draws, of = normal_draws(1, 0.05, values), recorded("side")
    both = Recorded(of.rows, {"K": "side", "C": "side"}, REFERENCE)
    notes = contrasts(draws, both, ["K", "C"], 0.1).set_index("quantity")["note"]
    assert notes.to_dict() == {"K": ELEMENT_ALONE, "C": ""}


PHASES = impacts().assign(phase=lambda table: np.arange(len(table)) % 4 + 1)
TRAINED = impacts().assign(trained=lambda table: (table["subject"] > "s1").astype(int))
TENSE = pd.concat([impacts(), impacts().assign(trial=lambda table: table["trial"] + "-tense")])
IMPACTS = {
    "phases": PHASES,
    "trained": TRAINED[TRAINED["mass_kg"] < 1],
    "tense": TENSE.reset_index(drop=True),
}


@pytest.mark.parametrize("case", cases(__file__))
def test_contrasts_and_their_ratios_are_those_by_hand(case: dict[str, Any]) -> None:
    values = {"intercept_K": 7.0, **case["values"]}
    of_levels = {name: each for name, each in values.items() if isinstance(each, dict)}
    levels = {name: (TERMS[name], list(each)) for name, each in of_levels.items()}
    plain = {name: list(each.values()) for name, each in of_levels.items()}
    of = recorded(case["formula"], IMPACTS.get(case.get("impacts", "")))
    table = contrasts(normal_draws(2, 0.0, values | plain, **levels), of, ["K"], 0.1)
    found = table.set_index(["factor", "level", "against"])["ratio"].to_dict()
    assert found == pytest.approx({tuple(names): np.exp(log) for *names, log in case["expected"]})


def test_many_levels_are_compared_with_their_mean() -> None:
    rows = impacts(people=13).assign(operator=lambda table: "o" + table["subject"])
    names, logs = rows["operator"].drop_duplicates().tolist(), np.linspace(-0.3, 0.3, 13).tolist()
    values, levels = {"intercept_K": 7.0, "operator_effect_K": logs}, ("operator", names)
    many = normal_draws(5, 0.0, values, operator_effect_K=levels)
    found = rows_of(contrasts(many, recorded("(1|operator)", rows), ["K"], 0.1), "operator")
    assert {names: row["ratio"] for names, row in found.items()} == pytest.approx(
        {(name, ALL): np.exp(log) for name, log in zip(names, logs, strict=True)}
    )


def test_a_question_of_categories_is_of_their_levels() -> None:
    values = {f"effect_of_C(phase)[{level}]_K": 0.1 * level for level in (2, 3, 4)}
    draws, of = normal_draws(7, 0.0, {"intercept_K": 7.0, **values}), recorded("C(phase)", PHASES)
    node = parse("mean(K[phase]) / K[phase=3] - K / K[phase=1]")
    assert not list(mistakes(node, Study(draws, of)))
    # K alone is that of the four phases, averaged on the log scale.
    each = np.exp(np.array([0.0, 0.2, 0.3, 0.4]) - 0.3).mean()
    assert_allclose(draws_at(node, Study(draws, of)), each - np.exp(0.9 / 4))
    assert "a level of phase: 1, 2, 3, 4" in str(*mistakes(parse("K[phase=2.5]"), Study(draws, of)))


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
    draws = normal_draws(
        *(5, 0.0, values),
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


def test_what_changes_with_a_factor_is_noted_whether_a_formula_has_it_or_not() -> None:
    known, draws, _ = clinic()
    table = contrasts(draws, known, ["K"], 0.1)
    assert rows_of(table, "session")["after", "before"]["note"] == "also differs: device (new against old)"
    own = rows_of(table, "subject:session")["s2:after", "s2:before"]["note"]
    assert own == "also differs: weight (66 against 62), device (new against old)"
    assert rows_of(table, "side")["left", "right"]["note"] == ""
