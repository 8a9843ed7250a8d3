from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayestissue.base.errors import InputError
from bayestissue.model.hierarchy.design import build_design
from bayestissue.model.hierarchy.formulas.formula import left_out_words, resolve
from bayestissue.model.hierarchy.specification import Formulas

PLAIN = "log(mass_kg) + (1|subject) + (1|trial)"


def rows(*, trials: int = 4, people: int = 3) -> pd.DataFrame:
    """A crossed design of energy and velocity, mass following from both."""
    energy = np.array([0.75, 0.75, 1.5, 1.5])[:trials]
    velocity = np.array([1.25, 1.75, 1.25, 1.75])[:trials]
    conditions = pd.DataFrame(
        {
            "trial": [f"{i}" for i in range(trials)],
            "energy_J": energy,
            "velocity_m_s": velocity,
            "mass_kg": 2 * energy / velocity**2,
        }
    )
    table = conditions.loc[conditions.index.repeat(people)].reset_index(drop=True)
    return table.assign(subject=[f"s{i}" for i in np.tile(np.arange(people), trials)])


def refusal(formula: str, table: pd.DataFrame) -> str:
    with pytest.raises(InputError) as caught:
        build_design(Formulas(K="1", C=formula), table, reference_mass_kg=None, source="m.toml")
    (problem,) = caught.value.problems
    assert problem.column == "formula.C"
    assert problem.value == formula
    return str(problem)


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("", "it is empty"),
        ("side + ", "it breaks off"),
        ("side + 'a", "a quotation mark is not closed: '"),
        ("side + (1|subject", "it has 1 of ( and 0 of )"),
        ("log(side)", "it can't be evaluated"),
        ("(" * 3000 + "side" + ")" * 3000, "too many parentheses"),
        ("K ~ side", "leave it out"),
        ("poly(mass_kg, 2)", "there is no poly()"),
        ("age + side", "age is missing in 1 of 4 impacts, such as impact b"),
    ],
)
def test_formulas_that_cannot_be_used_are_refused_in_our_words(formula, words):
    rows = pd.DataFrame({"impact": list("abcd"), "subject": list("ssuu"), "trial": list("xyxy")})
    rows = rows.assign(mass_kg=[0.5, 1.0] * 2, side=list("llrr"), age=[1.0, np.nan, 3.0, 4.0])
    assert words in " ".join(fault.reason for fault in resolve(formula, rows, 1.0).faults)


def test_log_mass_is_zero_at_the_reference_mass_and_is_not_scaled() -> None:
    table = rows()
    design = build_design(Formulas(), table, reference_mass_kg=0.5, source="m.toml")
    for response in "KC":
        assert_allclose(design.responses[response].log_mass, np.log(table["mass_kg"] / 0.5), atol=1e-14)
        assert design.responses[response].names == ()
        assert design.responses[response].groups == ("subject", "trial")
    assert design.subjects == ("s0", "s1", "s2")
    assert design.trials == ("0", "1", "2", "3")
    assert design.reference_mass_kg == 0.5
    design = build_design(Formulas(), table, reference_mass_kg=None, source="m.toml")
    assert_allclose(design.reference_mass_kg, np.exp(np.log(table["mass_kg"]).mean()), rtol=1e-14)


@pytest.mark.parametrize(
    ("formula", "expected", "reference"),
    [
        ("{mass_kg ** 2}", lambda t: t["mass_kg"] ** 2, 0.25),
        ("log(energy_J)", lambda t: np.log(t["energy_J"]), np.log(1.125)),
    ],
)
def test_other_covariates_are_zero_at_the_reference_and_scaled(formula, expected, reference) -> None:
    table = rows()
    one = f"{formula} + (1|subject)"
    part = build_design(Formulas(K=one, C=one), table, reference_mass_kg=0.5, source="m.toml").responses["K"]
    values = np.asarray(expected(table), float)
    assert part.log_mass is None
    assert_allclose(part.scale, [values.std()], rtol=1e-13)
    assert_allclose(part.covariates[:, 0] * part.scale, values - reference, atol=1e-13)


def test_the_reference_of_numbers_as_categories_is_the_first_recorded_one() -> None:
    # Their mean, 2.5, is no category.
    table = rows().assign(phase=lambda table: np.arange(len(table)) % 4 + 1)
    one = "C(phase) + (1|subject)"
    part = build_design(Formulas(K=one, C=one), table, reference_mass_kg=0.5, source="m.toml").responses["K"]
    assert part.names == ("C(phase)[2]", "C(phase)[3]", "C(phase)[4]")
    expected = table["phase"].to_numpy()[:, None] == [2, 3, 4]
    assert_allclose(part.covariates * part.scale, expected, atol=1e-13)


def test_both_formulas_problems_are_reported_at_once() -> None:
    with pytest.raises(InputError) as caught:
        build_design(Formulas(K="a", C="b"), rows(), reference_mass_kg=None, source="m.toml")
    assert [problem.column for problem in caught.value.problems] == ["formula.K", "formula.C"]


def adapted(table: pd.DataFrame) -> tuple[str | None, dict[str, str]]:
    """The formula that nobody wrote, and what it lacks of the default one by reason."""
    design = build_design(Formulas(), table, reference_mass_kg=None, source="m.toml")
    assert design.formulas.K == design.formulas.C
    left_out = design.terms_left_out()
    assert all(each["of"] == ["K", "C"] for each in left_out)
    # What is left can be written out.
    build_design(design.formulas, table, reference_mass_kg=None, source="m.toml")
    return design.formulas.K, {each["term"]: each["reason"] for each in left_out}


@pytest.mark.parametrize(
    ("table", "formula", "reasons"),
    [
        (
            rows().assign(mass_kg=0.5),
            "(1|subject) + (1|trial)",
            {"log(mass_kg)": "the mass is 0.5 kg in every impact"},
        ),
        (
            rows().assign(subject="s"),
            "log(mass_kg) + (1|trial)",
            {"(1|subject)": "there is one subject only"},
        ),
        (rows().assign(trial="t"), "log(mass_kg) + (1|subject)", {"(1|trial)": "there is one trial only"}),
        (
            rows(people=1),
            "log(mass_kg)",
            {"(1|subject)": "one subject only", "(1|trial)": "with one impact of each trial"},
        ),
        (
            rows(people=2).assign(subject=np.repeat(["a", "b", "c", "d"], 2)),
            "log(mass_kg) + (1|subject)",
            {"(1|trial)": "every person has one condition"},
        ),
        (
            rows(trials=1, people=1),
            "1",
            {"log(mass_kg)": "in every impact", "(1|subject)": "one subject", "(1|trial)": "one trial"},
        ),
    ],
)
def test_a_formula_left_out_is_what_the_rows_can_tell(table, formula, reasons) -> None:
    found, left_out = adapted(table)
    assert found == formula
    assert set(left_out) == set(reasons)
    for term, words in reasons.items():
        assert words in left_out[term]


@pytest.mark.parametrize(
    ("formula", "hidden", "by"),
    [("side + (1|session) + (1|subject)", "session", "side"), ("sex + (1|subject)", "subject", "sex")],
)
def test_a_factor_that_a_group_hides_is_refused_with_both_names(formula, hidden, by) -> None:
    people = 4 if hidden == "session" else 2
    cells = [(f"s{p}", side, mass) for p in range(people) for side in "lr" for mass in (0.5, 1.0, 0.5)]
    rows = pd.DataFrame(cells, columns=["subject", "side", "mass_kg"]).assign(trial="t", velocity_m_s=1.0)
    rows["session"] = (rows["side"] == "r").astype(int) + 1
    rows["sex"] = np.where(rows["subject"] == "s0", "f", "m")
    with pytest.raises(InputError) as caught:
        build_design(Formulas(K=formula, C="1"), rows, reference_mass_kg=None, source="m.toml")
    (problem,) = caught.value.problems
    assert problem.expected == f"several levels of {hidden} for each {by}"
    assert f"(1|{hidden}): {by} and {hidden} change together" in problem.remedy
    # A second session of one side is enough for the spread of sessions to have a say.
    if hidden == "session":
        rows.loc[rows.index[:3], "session"] = 3
        build_design(Formulas(K=formula, C="1"), rows, reference_mass_kg=None, source="m.toml")


def of_masses(*masses: float, people: int = 4) -> pd.DataFrame:
    """Three impacts of each person with each mass, a condition for each mass."""
    cells = [(f"s{p}", f"m{m}", m) for p in range(people) for m in masses for _ in range(3)]
    return pd.DataFrame(cells, columns=["subject", "trial", "mass_kg"])


def test_of_two_masses_the_default_has_no_effect_of_the_condition_beside_the_exponent() -> None:
    found, left_out = adapted(of_masses(0.5, 1.0))
    assert found == "log(mass_kg) + (1|subject)"
    assert list(left_out) == ["(1|trial)"]
    for words in ("two conditions, each with one mass", "a third mass would tell it"):
        assert words in left_out["(1|trial)"]
    assert adapted(of_masses(0.5, 1.0, people=1))[0] == "log(mass_kg)"
    # Weighed anew each time, they differ a little.
    weighed = of_masses(0.5, 1.0).assign(mass_kg=lambda t: t["mass_kg"] * (1 + 0.003 * np.sin(range(len(t)))))
    assert adapted(weighed)[0] == "log(mass_kg) + (1|subject)"


def test_conditions_that_say_more_than_their_masses_stay_in_the_default() -> None:
    assert adapted(of_masses(0.5, 0.7, 1.0)) == (PLAIN, {})
    # Two masses in two conditions each; two conditions of both masses.
    for of_trial in (["a", "b", "c"], ["a", "b", "a"]):
        assert adapted(of_masses(0.5, 1.0).assign(trial=np.resize(of_trial, 24)))[0] == PLAIN
    twice = of_masses(0.5, 1.0).assign(trial=lambda t: t["trial"] + np.resize(["a", "b", "a"], len(t)))
    assert adapted(twice) == (PLAIN, {})


def test_two_people_with_a_mass_each_differ_by_person() -> None:
    table = of_masses(0.5, 1.0, people=2).assign(trial="t", subject=lambda t: "s" + t["mass_kg"].astype(str))
    found, left_out = adapted(table)
    assert found == "(1|subject)"
    assert "there are two people, each with one mass" in left_out["log(mass_kg)"]


def test_a_mass_that_differs_by_rounding_alone_has_no_exponent() -> None:
    table = rows().assign(mass_kg=lambda t: 0.5 * (1 + 1e-12 * np.arange(len(t))))
    assert adapted(table)[0] == "(1|subject) + (1|trial)"


def test_one_of_the_formulas_may_be_left_out() -> None:
    table = rows().assign(mass_kg=0.5)
    design = build_design(Formulas(K="(1|subject)"), table, reference_mass_kg=None, source="m.toml")
    assert design.formulas == Formulas(K="(1|subject)", C="(1|subject) + (1|trial)")
    assert [each["of"] for each in design.terms_left_out()] == [["C"]]
    assert left_out_words(design.terms_left_out()).startswith(
        "Left out of the formula: log(mass_kg) of log C"
    )


def test_all_that_is_wrong_with_a_formula_is_said_at_once_with_one_that_works() -> None:
    table = rows(people=1).assign(mass_kg=0.5, room="a")
    said = refusal("log(mass_kg) + energy_J + room + width + {2 * energy_J} + (1|subject) + (1|trial)", table)
    for words in (
        "a mass that varies",
        "covariates that vary",
        "no column width",
        "more than one subject",
        "several impacts for at least one trial",
        "no combination of each other",
    ):
        assert words in said
    # Of a name that is misspelt, or a cell that is empty, the formula without it is none that was asked for.
    assert "Write" not in said
    assert 'Write "energy_J" instead' in refusal("log(mass_kg) + energy_J + room", table)
    gap = table.assign(side=["left", "right", "", "left"])
    assert "Write" not in refusal("energy_J + side + {2 * energy_J}", gap)


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("log(mass_kg", "formula such as"),
        ("exp(mass_kg) + energy_J", "log() and sqrt()"),
        ("log(mass_kg) + subject", "group effect"),
        ("a:b", "no column a"),
    ],
)
def test_no_formula_is_proposed_without_a_term_that_can_be_mended(formula: str, words: str) -> None:
    said = refusal(formula, rows())
    assert words in said
    assert "Correct the formula" in said
    assert "instead" not in said


@pytest.mark.parametrize(
    ("formula", "works"),
    [
        ("0 + log(mass_kg)", "log(mass_kg)"),
        ("energy_J + velocity_m_s + log(mass_kg) + (1|trial)", "energy_J + velocity_m_s + (1|trial)"),
        ("`skin fold` + mass_kg + {2 * mass_kg}", "`skin fold` + mass_kg"),
    ],
)
def test_the_formula_that_works_does(formula: str, works: str) -> None:
    table = rows().assign(**{"skin fold": np.arange(12.0)})
    assert f'Write "{works}" instead' in refusal(formula, table)
    build_design(Formulas(K=works, C=works), table, reference_mass_kg=None, source="m.toml")
