"""Checks of a publication: faults planted in a made-up one, and what is known of the thesis's own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset.published import PublishedTables, read_published
from bayestissue.thesis.audit import CHECKS_OF_IMPACTS, CHECKS_OF_PUBLICATION, audit_published
from bayestissue.thesis.audit.inconsistencies import BEARINGS, SEVERITIES, TEXTS, Publication, findings
from bayestissue.thesis.audit.printed import (
    claims_that_contradict,
    figures_that_do_not_follow,
    masses_behind_the_regression,
)
from bayestissue.thesis.audit.reasoning import not_the_only_one

VARIABLES = ("Mass", "Mass Sq", "Energy * Mass", "Energy", "Velocity")


def printed(frame: pd.DataFrame, decimals: int = 3) -> pd.DataFrame:
    """Round the numbers as a table does, and keep their text beside them."""
    for column in frame.select_dtypes("float64").columns:
        frame[f"{column}_text"] = frame[column].map(
            lambda value: "" if np.isnan(value) else f"{value:.{decimals}f}"
        )
        frame[column] = pd.to_numeric(frame[f"{column}_text"])
    return frame


def factor(table: pd.DataFrame, name: str) -> pd.Series:
    column = {"Mass": "mass_kg", "Energy": "energy_J", "Velocity": "velocity_m_s"}
    if name.endswith(" Sq"):
        return table[column[name.removesuffix(" Sq")]] ** 2
    return table[[column[part.strip()] for part in name.split("*")]].prod(axis=1)


@cache
def clean() -> Publication:
    """A publication without a fault: its tables follow from its rows, its text from its tables."""
    rng = np.random.default_rng(7)
    energy, velocity = (grid.ravel() for grid in np.meshgrid([0.75, 1.125, 1.5], [1.25, 1.5, 1.75]))
    trial, subject = (grid.ravel() for grid in np.meshgrid(np.arange(1, 10), np.arange(1, 11), indexing="ij"))
    estimates = pd.DataFrame(
        {
            "table": "1",
            "row": np.arange(trial.size) + 1,
            "trial": trial,
            "subject": subject,
            "energy_J": energy[trial - 1],
            "velocity_m_s": velocity[trial - 1],
            "mass_kg": (2 * energy / velocity**2)[trial - 1],
        }
    )
    for name, level in (("K", 300), ("C", 25)):
        person = rng.normal(0, 0.03, 10)[subject - 1]
        estimates[name] = level * estimates["mass_kg"] * np.exp(person + rng.normal(0, 0.02, trial.size))
    estimates = printed(estimates)
    averages, correlations, regressions = [], [], []
    for table, name in (("5.10", "K"), ("5.11", "C")):
        groups = estimates.groupby("trial")
        one = groups[["energy_J", "velocity_m_s", "mass_kg"]].first()
        one["average"], one["sd"] = groups[name].mean(), groups[name].std()
        one["range"] = groups[name].max() - groups[name].min()
        averages.append(one.reset_index().assign(table=table, row=np.arange(1, 10), quantity=name))
        for number, source in (("5.12", estimates), ("5.15" if name == "C" else "5.14", one)):
            if (number, name) == ("5.12", "C"):
                continue
            y = source[name] if source is estimates else source["average"]
            correlations += [
                (number, row + 1, variable, name, np.corrcoef(factor(source, variable), y)[0, 1], np.nan)
                for row, variable in enumerate(VARIABLES)
            ]
        slope, constant = np.polyfit(one["mass_kg"], one["average"], 1)
        r = np.corrcoef(one["mass_kg"], one["average"])[0, 1]
        regressions += [(name, "constant", constant, r**2), (name, "Mass", slope, r**2)]
    stepwise = [
        ("5.17", row + 1, name, "entered" if row == 0 else "not entered", variable)
        for name in "KC"
        for row, variable in enumerate(VARIABLES)
    ]
    tables = PublishedTables(
        estimates=estimates,
        averages=printed(pd.concat(averages, ignore_index=True)),
        correlations=printed(
            pd.DataFrame(
                correlations, columns=["table", "row", "variable", "quantity", "correlation", "p_value"]
            )
        ),
        stepwise=pd.DataFrame(stepwise, columns=["table", "row", "quantity", "status", "variable"]),
        regressions=printed(
            pd.DataFrame(regressions, columns=["quantity", "term", "coefficient", "r_squared"])
        ),
        claims=claims_of(
            ("5.1", "K", "minimum", f"{estimates['K'].min():.3f}", ""),
            ("5.1", "K", "maximum", f"{estimates['K'].max():.3f}", ""),
            ("5.1", "K", "range", f"{estimates['K'].max() - estimates['K'].min():.3f}", ""),
        ),
        paths=(),
    )
    return Publication(tables)


def claims_of(*claims: tuple[str, str, str, str, str]) -> pd.DataFrame:
    frame = pd.DataFrame(claims, columns=["section", "quantity", "statistic", "value_text", "sentence"])
    return frame.assign(claim=np.arange(len(frame)) + 1, value=pd.to_numeric(frame["value_text"]))


def changed(**tables: pd.DataFrame) -> Publication:
    return Publication(replace(clean().tables, **tables))


def with_claims(*claims: tuple[str, str, str, str, str]) -> Publication:
    return changed(claims=claims_of(*claims))


def with_cell(frame: pd.DataFrame, row: int, column: str, text: str) -> pd.DataFrame:
    frame = frame.copy()
    frame.loc[row, column], frame.loc[row, f"{column}_text"] = float(text), text
    return frame


def names_of(publication: Publication) -> set[str]:
    return {check.__name__ for check in CHECKS_OF_PUBLICATION if list(check(publication))}


def explained(publication: Publication, check) -> str:
    (found,) = findings([check], publication)
    return found.explanation


def test_a_clean_publication_gives_no_finding() -> None:
    assert names_of(clean()) == set()


def test_a_wrong_standard_deviation_is_found() -> None:
    averages = clean().tables.averages
    wrong = averages.loc[4, "range_text"]
    publication = changed(averages=with_cell(averages, 4, "sd", wrong))
    assert names_of(publication) == {"figures_that_do_not_follow"}
    assert "repeats the range" in explained(publication, figures_that_do_not_follow)


@pytest.mark.slow
def test_a_spread_that_no_numbers_have_is_found_without_rows() -> None:
    averages = clean().tables.averages
    lost = clean().tables.estimates.query("trial != 5").reset_index(drop=True)
    assert "impossible_spread" not in names_of(changed(estimates=lost))
    publication = changed(
        estimates=lost, averages=with_cell(averages, 4, "sd", averages.loc[4, "range_text"])
    )
    assert "impossible_spread" in names_of(publication)


def test_masses_behind_an_equation_are_recognised() -> None:
    averages = clean().tables.averages.copy()
    exact = 2 * averages["energy_J"] / (averages["velocity_m_s"] + 0.25) ** 2
    averages["mass_kg"] = np.trunc(exact * 1000) / 1000
    averages["mass_kg_text"] = averages["mass_kg"].map("{:.3f}".format)
    regressions = clean().tables.regressions
    response = clean().tables.estimates.groupby("trial")["K"].mean()
    constant = np.polyfit(exact.iloc[: len(response)], response, 1)[1]
    publication = changed(
        averages=averages, regressions=with_cell(regressions, 0, "coefficient", f"{constant:.3f}")
    )
    assert "1.5, 1.75, 2 m/s" in explained(publication, masses_behind_the_regression)


@pytest.mark.slow
def test_a_figure_given_twice_is_found_and_last_digits_are_a_note() -> None:
    for second, severity in (("1.122", "note"), ("2.5", None)):
        publication = with_claims(("1", "C", "mean", "1.121", ""), ("2", "C", "mean", second, ""))
        (found,) = findings([claims_that_contradict], publication)
        assert found.severity == (severity or "minor")
    rounded = with_claims(("1", "C", "mean", "1.121", ""), ("2", "C", "mean", "1.12", ""))
    assert "claims_that_contradict" not in names_of(rounded)


@pytest.mark.slow
@pytest.mark.parametrize(("statistic", "text"), [("range", "4.0"), ("ratio of maximum to minimum", "3.0")])
def test_arithmetic_is_checked(statistic: str, text: str) -> None:
    ends = (("1", "C", "minimum", "1.0", ""), ("1", "C", "maximum", "4.5", ""))
    assert "arithmetic_of_claims" in names_of(with_claims(*ends, ("1", "C", statistic, text, "")))
    right = {"range": "3.5", "ratio of maximum to minimum": "4.5"}[statistic]
    assert "arithmetic_of_claims" not in names_of(with_claims(*ends, ("1", "C", statistic, right, "")))


def test_an_insignificant_correlation_among_the_significant_is_found() -> None:
    sentence = "For all variables considered statistically significant, values went down to 0.1."
    correlations = clean().tables.correlations.assign(p_value=0.0, p_value_text="0.000")
    claims = claims_of(("5.3", "K", "correlation with Velocity", "-0.1", sentence))
    assert "not_significant_after_all" not in names_of(changed(claims=claims, correlations=correlations))
    correlations = with_cell(correlations, 4, "p_value", "0.8")
    assert "not_significant_after_all" in names_of(changed(claims=claims, correlations=correlations))


def test_the_only_significant_variable_is_checked() -> None:
    sentence = "Mass was the only variable statistically significant."
    publication = with_claims(("5.3", "C", "correlation with Mass", "0.9", sentence))
    assert "Energy" in explained(publication, not_the_only_one)


@pytest.mark.slow
def test_impossible_correlations_with_a_sum_are_found() -> None:
    def table(total: str) -> pd.DataFrame:
        rows = [("Skin", "-0.191"), ("Muscle", "-0.176"), ("Skin+ Muscle", total)]
        frame = pd.DataFrame(rows, columns=["variable", "correlation_text"])
        return frame.assign(
            table="5.12",
            row=[1, 2, 3],
            quantity="K",
            correlation=pd.to_numeric(frame["correlation_text"]),
            p_value=np.nan,
            p_value_text="",
        )

    assert "correlation_with_a_sum" in names_of(changed(correlations=table("-0.137")))
    # independent parts of equal size: (a + b) / √2
    assert "correlation_with_a_sum" not in names_of(changed(correlations=table("-0.259")))


@pytest.mark.slow
def test_personal_factors_of_averages_over_the_same_people_are_found() -> None:
    correlations = clean().tables.correlations.copy()
    correlations.loc[len(correlations) - 1, "variable"] = "Skin Fold"
    assert "personal_factors_of_averages" in names_of(changed(correlations=correlations))
    # someone stayed away from a trial: the averages are then not over the same people
    fewer = clean().tables.estimates.drop(index=0).reset_index(drop=True)
    assert "personal_factors_of_averages" not in names_of(changed(correlations=correlations, estimates=fewer))


@pytest.mark.slow
def test_the_sign_of_a_personal_factor_is_checked() -> None:
    correlations = clean().tables.correlations.copy()
    correlations.loc[4, "variable"] = "Skin Fold"
    correlations = with_cell(correlations, 4, "correlation", "-0.024")
    term = clean().tables.regressions.iloc[[1]].assign(term="SFT")
    for coefficient, found in (("0.0028", True), ("-0.0028", False)):
        extra = with_cell(term, 1, "coefficient", coefficient)
        regressions = pd.concat([clean().tables.regressions, extra], ignore_index=True)
        names = names_of(changed(correlations=correlations, regressions=regressions))
        assert ("sign_of_a_personal_factor" in names) is found


def test_r_squared_of_averages_is_found() -> None:
    regressions = with_cell(clean().tables.regressions, 0, "r_squared", "0.2")
    assert "r_squared_of_averages" in names_of(changed(regressions=regressions))


@pytest.fixture(scope="module")
def thesis() -> pd.DataFrame:
    return audit_published(read_published())


@pytest.mark.slow
def test_the_three_worst_are_the_most_damaging(thesis: pd.DataFrame) -> None:
    assert list(thesis["what"].head(3)) == [
        "K against the mass of the impactor",
        "penetration that K and C imply",
        "energy, velocity and mass",
    ]
    assert list(thesis["severity"].head(5)) == ["major"] * 5
    order = [SEVERITIES.index(severity) for severity in thesis["severity"]]
    assert order == sorted(order)


@pytest.mark.parametrize(
    ("what", "published", "implied"),
    [
        ("energy, velocity and mass", "V = 1.25, 1.5, 1.75", "V = 1.5, 1.75, 2 m/s"),
        ("penetration that K and C imply", "6.3 mm", "15 to 33 cm"),
        ("standard deviation of K, trial 17", "1.977", "0.629"),
        ("range of C, trial 9", "1.943", "1.500"),
        ("range of C, trial 16", "3.105", "2.122"),
        ("trial 18, subjects 2 and 9", "13.374", ""),
        ("C: minimum", "0.121 and .0122", "0.121"),
        ("C: range", "4.500 and 4.626 and 4.504", "4.505"),
        ("K: correlation with Mass", "0.997 and 0.992", "0.997"),
        ("K: minimum", "8.832 and 8.833", "8.832"),
        ("ratio of maximum to minimum of C against its ends", "37.90", "379"),
        ("R² of the equation of C", "0.97", "0.62"),
        ("significance of Skin Fold for K", "-0.024", "0.818"),
        ("variables significant for C", "Mass only", "10 of 10"),
        ("correlation of K with Skin Fold+ Muscle Thickness", "-0.137", "0.176"),
        ("masses in the equation of K", "0.695", "0.6952"),
    ],
)
def test_the_thesis_holds_what_is_known(
    thesis: pd.DataFrame, what: str, published: str, implied: str
) -> None:
    found = thesis[thesis["what"] == what]
    assert len(found) == 1
    assert published in found["published"].iloc[0]
    assert implied in found["implied"].iloc[0]


def test_every_finding_is_whole(thesis: pd.DataFrame) -> None:
    assert (thesis != "").all(axis=None)
    assert not thesis["explanation"].str.contains("nan|None|inf ", regex=True).any()
    assert thesis["explanation"].str.endswith((".", "hold.")).all()
    assert not thesis.duplicated().any()


def test_every_check_says_why_it_is_that_serious() -> None:
    assert {check.__name__ for check in (*CHECKS_OF_IMPACTS, *CHECKS_OF_PUBLICATION)} == set(TEXTS)
    for check in (*CHECKS_OF_IMPACTS, *CHECKS_OF_PUBLICATION):
        said = TEXTS[check.__name__]
        assert said["severity"] in SEVERITIES
        assert said["bearing"] in BEARINGS
        assert f"{said['severity'].capitalize()}: " in str(check.__doc__)
