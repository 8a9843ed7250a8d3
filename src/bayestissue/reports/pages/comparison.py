"""The page of a comparison of finished fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.base.errors import InputError
from bayestissue.base.outcome_table import REFERENCE_OUTCOMES
from bayestissue.base.remedies import codes_in
from bayestissue.base.results.tables import read_tables, table_of_rows, typed, wrong_in
from bayestissue.inference.results.meanings import NAMES, UNITS, heading_words, outcome_name
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.reports.figures.intervals import intervals, with_error_of
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.pages.page import render_page
from bayestissue.reports.pages.page_tables import Table, settings_table, table_of_cells
from bayestissue.reports.pages.wording import interval, nouns_of, number, probability, said, significant

MOST_PEOPLE = 30
OF_IMPACTS = {"K": "K_secant_of_impacts", "C": "C_equivalent_of_impacts"}
_OF_SUBJECT = {"K": "K_secant_of_subject", "C": "C_equivalent_of_subject"}


def comparison_figure(table: pd.DataFrame, scheme: str) -> Figure:
    """Differences of expected log predictive density from the best model, with one standard error."""
    rows = table[table["scheme"] == scheme].sort_values("elpd", ascending=False, ignore_index=True)
    return intervals(
        with_error_of(rows["model"], rows["elpd_difference"], rows["se_difference"]),
        f"elpd off the best, {scheme} (nats)",
        said("figures.elpd", scheme=scheme),
        lines=(0,),
    )


def figures_by_run(posteriors: pd.DataFrame, quantity: str, one_element: bool) -> list[Figure]:
    """The mass exponent, K (or C) of a typical, a new and each person: a colour and a mark a run.

    Unless K and C are those of ``one_element`` in all runs, what means the same in all stands for K
    (or C): the secant stiffness (the equivalent damping) of the recorded impacts, and of each person's own.
    """
    of_element = (f"{quantity}_typical_person", f"{quantity}_new", f"{quantity}_subject")
    values = of_element if one_element else (OF_IMPACTS[quantity], _OF_SUBJECT[quantity])
    exponents = (f"mass_exponent_{quantity}", f"mass_exponent_{quantity}_common_depth")
    figures = []
    for variable in (*exponents, *values):
        rows = posteriors[posteriors["variable"] == variable]
        if len(rows):
            what, exponent = heading_words(variable, rows["of"].iloc[0]), variable in exponents
            title = f"{what} ({'no unit' if exponent else UNITS[quantity]})"
            figures.append(_drawn(rows, f"{NAMES[quantity]} by run: {what}", title, exponent=exponent))
    return figures


def outcome_figures(posteriors: pd.DataFrame) -> list[Figure]:
    """Each outcome of the reference impact, on a typical, a new and each person: a colour and mark a run."""
    parts = {}
    for name in REFERENCE_OUTCOMES:
        levels = [f"{name}_{level}" for level in ("typical_person", "new", "subject")]
        rows = posteriors[posteriors["variable"].isin(levels)]
        # Whoever is new has no name either.
        parts[name] = rows.assign(label=rows["label"].mask(rows["variable"] == f"{name}_new", "new"))
    return [
        _drawn(rows, outcome_name(name), f"{outcome_name(name)} ({rows['unit'].iloc[0]})", "typical")
        for name, rows in parts.items()
        if len(rows)
    ]


def _drawn(
    rows: pd.DataFrame, words: str, title: str, unlabelled: str = "all", *, exponent: bool = False
) -> Figure:
    shown = rows[rows["label"].isin(rows["label"].drop_duplicates()[:MOST_PEOPLE])]
    shown = shown.rename(columns={"run": "series"}).replace({"label": {"": unlabelled}})
    return intervals(
        shown[["label", "series", "median", "eti90_low", "eti90_high"]],
        title,
        said("figures.by_run", words=words),
        lines=(0, 1) if exponent else (),
        straight=exponent,
    )


def answers_table(answers: pd.DataFrame, runs: Sequence[str]) -> Table:
    """A row a ratio or question, a column a run: "1.24 (1.19 to 1.29)", a probability, or what lacks."""
    cells = {(row["question"], row["run"]): answer_words(row) for row in answers.to_dict("records")}
    rows = [
        (str(question), *(cells.get((question, run), "not in this run") for run in runs))
        for question in dict.fromkeys(answers["question"])
    ]
    return table_of_cells(rows, "question", *runs, number=runs, words=("question",))


def answer_words(row: Mapping[Any, Any]) -> str:
    """The probability, or the value with its 90 % interval."""
    if row["kind"] == "probability":
        return f"probability {probability(row['value'])}"
    unit = "" if row["kind"] in ("ratio", "1") else f" {row['kind']}"
    return f"{significant(row['value'])}{unit} ({interval(row['low'], row['high'])})"


def answers_figure(answers: pd.DataFrame) -> Figure | None:
    """The ratios that several runs have, a colour and a mark a run; None where there are none."""
    ratios = answers[answers["kind"] == "ratio"]
    ratios = ratios[ratios.groupby("question")["run"].transform("nunique") > 1]
    questions = list(ratios["question"].drop_duplicates()[:MOST_PEOPLE])
    if not questions:
        return None
    rows = ratios.loc[ratios["question"].isin(questions), ["question", "run", "value", "low", "high"]]
    rows = rows.set_axis(["label", "series", "median", "eti90_low", "eti90_high"], axis=1)
    words = said("figures.ratios_by_run")
    return intervals(rows.reset_index(drop=True), "ratio", words, lines=(1,))


TABLES = ("comparison", "posteriors")
_APART = (r"(; )?densities of other numbers.*", "")
_AGAIN = "Compare the runs anew with `bayestissue compare`."


def comparison_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the comparison in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: a file lacks or isn't what `bayestissue compare` writes.
    """
    runs = record.get("runs")
    if not isinstance(runs, list) or not all(
        isinstance(r, dict) and {"name", "model"} <= set(r) for r in runs
    ):
        raise InputError(wrong_in(folder / "run.json", "the runs compared", _AGAIN, column="runs"))
    return page_of(read_tables(folder, TABLES, ("answers",)), record)


def page_of(tables: Mapping[str, pd.DataFrame], record: dict[str, Any]) -> str:
    """The HTML of a comparison: its `TABLES` by name, and the content of ``run.json``."""
    comparison, posteriors = (typed(name, tables[name]) for name in TABLES)
    runs = record["runs"]
    names = [str(run["name"]) for run in runs]
    answers = tables.get("answers", table_of_rows("answers"))
    verdicts = {str(run["name"]): run.get("verdict") or {} for run in runs}
    # Beside a discrepancy K is the element's own, of which there are no rows.
    elements = {run["model"].get("element", SIDE_BY_SIDE) for run in runs}
    one_element = len(elements) == 1 and set(posteriors.loc[posteriors["variable"] == "K_new", "run"]) == set(
        names
    )
    return render_page(
        "comparison.html",
        nouns=nouns_of(record, names),
        codes=codes_in(*comparison["warning"]),
        record=record,
        names=names,
        failed=[name for name, verdict in verdicts.items() if not verdict.get("passed")],
        warned=[run for run in runs if verdicts[str(run["name"])].get("warned")],
        one_element=one_element,
        # The page says once, and first, which densities can't be compared.
        comparison=comparison.assign(warning=comparison["warning"].str.replace(*_APART, regex=True)),
        posteriors=posteriors,
        answers=answers,
        shown={q: f"{q}_new" if one_element else together for q, together in OF_IMPACTS.items()},
        people=len(set(posteriors["label"]) - {""}),
    )


def comparable(comparison: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """The rows of each kind of data that several runs share."""
    groups = [(str(data), rows) for data, rows in comparison.groupby("data", sort=False)]
    return [(data, rows) for data, rows in groups if len(rows["model"].unique()) > 1]


def runs_by_data(comparison: pd.DataFrame) -> list[tuple[str, list[str]]]:
    """Of which numbers the likelihoods are densities, and the names of the runs of each."""
    groups = comparison.groupby("data", sort=False)["model"].unique()
    return [(str(data), list(names)) for data, names in groups.items()]


def accuracy_figures(comparison: pd.DataFrame) -> list[Figure]:
    """One plot for each scheme and each kind of data that several runs share."""
    return [
        comparison_figure(rows, scheme)
        for _, rows in comparable(comparison)
        for scheme in rows["scheme"].drop_duplicates()
    ]


def interval_subject(posteriors: pd.DataFrame, variable: str) -> str:
    """What the intervals of a variable are of, the mass left out; empty if there are none."""
    subjects = posteriors.loc[posteriors["variable"] == variable, "of"]
    return str(subjects.iloc[0]).removesuffix(" at the reference mass") if len(subjects) else ""


def quantity_rows(posteriors: pd.DataFrame, runs: list[str], variable: str) -> list[dict[str, str]]:
    """Median and 90 % interval of a quantity without labels, by run; "not in this model" where it lacks."""
    return _rows_by_run(posteriors[posteriors["variable"] == variable], runs, significant)


def exponent_rows(posteriors: pd.DataFrame, runs: list[str], quantity: str) -> list[dict[str, str]]:
    """The mass exponent of K or C by run, of K that at the common depth in runs that have one."""
    name = f"mass_exponent_{quantity}"
    at_depth = posteriors[posteriors["variable"] == f"{name}_common_depth"]
    without_depth = posteriors[(posteriors["variable"] == name) & ~posteriors["run"].isin(at_depth["run"])]
    return _rows_by_run(pd.concat([at_depth, without_depth]), runs, partial(number, decimals=2))


def _rows_by_run(rows: pd.DataFrame, runs: list[str], words: Callable[[float], str]) -> list[dict[str, str]]:
    present = {
        row["run"]: {
            "value": words(row["median"]),
            "range": interval(row["eti90_low"], row["eti90_high"]),
            "unit": "" if row["unit"] == "1" else str(row["unit"]),
        }
        for row in rows.to_dict("records")
    }
    absent = {"value": "not in this model", "range": "", "unit": ""}
    return [{"run": run, **present.get(run, absent)} for run in runs]


def reference_masses(runs: list[dict[str, Any]]) -> dict[str, str]:
    """At which mass new impacts and people are reported, by run; empty of one that has its own mean mass."""
    masses = {str(run["name"]): run["model"].get("reference_mass_kg") for run in runs}
    return {name: "" if mass is None else f"{float(mass):.3g} kg" for name, mass in masses.items()}


def differing_settings(runs: list[dict[str, Any]]) -> Table:
    """The settings in which the models differ, a column a run."""
    names = [str(run["name"]) for run in runs]
    flat = [{row.cells[0]: row.cells[1] for row in settings_table(run["model"]).rows} for run in runs]
    rows = {key: [settings.get(key, "not set") for settings in flat] for settings in flat for key in settings}
    rows["seed"] = [str(run.get("seed", "")) for run in runs]
    differing = [(key, *values) for key, values in rows.items() if len(set(values)) > 1]
    return table_of_cells(differing, "setting", *names, words=names)
