"""The page of a run of point estimates."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.figures.impacts import MASS, axis_title, end
from bayestissue.figures.study import points
from bayestissue.figures.theme import Figure, number
from bayestissue.inference.points.notes import PHANTOM, people_alone, said_once
from bayestissue.inference.results.meanings import COLUMNS, NAMES, QUANTITIES, UNITS
from bayestissue.remedies import codes_in
from bayestissue.report.page import render_page
from bayestissue.report.settings import LIMITS
from bayestissue.report.tables import Field, Table, number_field, settings_table, shown, table_of
from bayestissue.report.wording import SENTENCES, digits, interval, listed, nouns_of, significant
from bayestissue.report.wording import number as in_words
from bayestissue.results import read_tables
from bayestissue.results.tables import declared_files, typed

# What is shown of `estimates.csv`: of points, and of the posteriors of the method "impact".
_POINTS = (
    *("impact", "subject", "trial", "mass_kg", "velocity_m_s", "omega_n_rad_s", "zeta"),
    *("K_N_per_m", "C_N_s_per_m", "flags"),
)
_POSTERIORS = (
    *("impact", "subject", "trial", "mass_kg", "velocity_m_s", "zeta"),
    *("K_N_per_m", "K_low_N_per_m", "K_high_N_per_m", "C_N_s_per_m", "C_low_N_s_per_m", "C_high_N_s_per_m"),
    *("peak_force_N", "peak_depth_m", "flags"),
)
# Tables that a run may hold beside its estimates, with their heading and what to look for.
_FURTHER: dict[str, list[str]] = SENTENCES["beside_estimates"]
_SETTINGS = ("options", "method", "signal", "model")


def estimates_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the page of the point estimates in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: `estimates.csv` lacks, or lacks a column.
    """
    return page_of(read_tables(folder, ["estimates"], list(_FURTHER)), record)


def page_of(tables: Mapping[str, pd.DataFrame], record: dict[str, Any]) -> str:
    """The HTML of the page of point estimates: ``tables`` by name, the content of ``run.json``."""
    table = typed("estimates", tables["estimates"])
    notes = list(table.get("notes", []))
    return render_page(
        "estimates.html",
        page=sys.modules[__name__],
        nouns=nouns_of(record, set(table[["impact", "subject", "trial"]].to_numpy(str).ravel())),
        codes=codes_in("; ".join([*table["flags"], *notes])),
        record=record,
        impacts=table,
        people=people_alone(table),
        flagged=int((table["flags"] != "").sum()),
        notes=said_once(notes),
        plots=[estimate_figure(table, q) for q in QUANTITIES] if table["mass_kg"].notna().any() else [],
        further={
            name: (heading, words, plain_table(name, tables[name]))
            for name, (heading, words) in _FURTHER.items()
            if name in tables
        },
        sections=[(name, heading) for name, (heading, _) in _FURTHER.items() if name in tables],
        settings=settings_table({key: record[key] for key in _SETTINGS if key in record}),
    )


def by_posterior(table: pd.DataFrame) -> bool:
    """Whether the method was "impact", which alone weights importance."""
    return "pareto_k" in table


def level(table: pd.DataFrame, q: str) -> dict[str, str]:
    """The middle and the spread of K or C over the impacts, as text."""
    values = table[COLUMNS[q]].dropna()
    low, median, high = np.percentile(values, [5, 50, 95]) if len(values) else [np.nan] * 3
    return {
        "name": NAMES[q],
        "unit": UNITS[q],
        "median": significant(median),
        "range": interval(low, high),
        "sure": _relative_half_width(table, q),
        "missing": str(len(table) - len(values)) if len(values) < len(table) else "",
    }


def _relative_half_width(table: pd.DataFrame, q: str) -> str:
    """Half of a single impact's interval, as a share of it, in the median impact; of posteriors alone."""
    if not by_posterior(table):
        return ""
    half = ((table[end(q, "high")] - table[end(q, "low")]) / 2 / table[COLUMNS[q]]).median()
    return "" if pd.isna(half) else f"{100 * half:.2g} %"


def flag_counts(table: pd.DataFrame) -> str:
    """How often each flag was raised, the commonest first, in words."""
    flags = table["flags"].str.split("; ").explode()
    counts = flags[flags != ""].value_counts()
    return listed([f"{flag} ({count})" for flag, count in counts.items()])


def estimates_table(table: pd.DataFrame) -> Table:
    """The impacts that need a look first: those with flags, then the others in their order."""
    order = (
        table.assign(_clean=table["flags"] == "").sort_values("_clean", kind="stable").index[: LIMITS.rows]
    )
    return shown(
        "estimates",
        table.loc[order],
        _POSTERIORS if by_posterior(table) else _POINTS,
        mark=lambda row: "disagrees" if row["flags"] else "",
    )


def estimate_figure(table: pd.DataFrame, q: str) -> Figure:
    """K or C of every impact over the mass; flagged impacts have a colour and a shape of their own."""
    rows = table[["impact", "subject", "trial", "mass_kg", COLUMNS[q]]]
    rows = rows.rename(columns={"subject": "person", "trial": "condition"})
    rows["kind"] = np.where(table["flags"] != "", "flagged", "no flag")
    phantom = table.index.difference(people_alone(table).index)
    rows.loc[phantom, "kind"] = rows.loc[phantom, "kind"].replace("no flag", PHANTOM)
    if by_posterior(table):
        rows["low"], rows["high"] = (table[end(q, side)] for side in ("low", "high"))
    kinds = ["no flag", "flagged", PHANTOM]
    rows = rows.sort_values("kind", key=lambda kind: kind.map(kinds.index), kind="stable", ignore_index=True)
    return points(
        rows,
        number("mass_kg", MASS, scale={"zero": False, "padding": 12}),
        number(COLUMNS[q], axis_title(q), scale={"zero": False}),
        f"Point estimates of {NAMES[q]} of every impact over the mass; the legend names the marks.",
    )


def mass_trend(table: pd.DataFrame) -> str:
    """The slopes of log K and log C on log mass over all impacts, least squares; empty if mass doesn't vary.

    No interval is given: impacts of one person and of one condition are not independent.
    """
    words = []
    for q in QUANTITIES:
        known = table[(table[COLUMNS[q]] > 0) & (table["mass_kg"] > 0)]
        mass = np.log(known["mass_kg"].to_numpy())
        if mass.size and np.ptp(mass) > 0:
            slope = np.polynomial.polynomial.polyfit(mass, np.log(known[COLUMNS[q]].to_numpy()), 1)[1]
            words.append(f"{NAMES[q]} goes with mass to the power {in_words(slope, 2)}")
    return f"Over these impacts {listed(words)}." if words else ""


def plain_table(name: str, frame: pd.DataFrame) -> Table:
    """A whole table as it is declared: numbers to the right, those that aren't whole with four digits."""
    declared, frame = declared_files()[f"{name}.csv"].columns, typed(name, frame)

    def field(column: str) -> Field:
        otherwise = "number" if pd.api.types.is_numeric_dtype(frame[column]) else "text"
        kind = declared[column].kind if column in declared else otherwise
        if kind == "text":
            return Field(column, column, "words" if column in ("expected", "remedy") else "text")
        return number_field(column, column, "{:.0f}".format if kind == "whole" else digits(4))

    return table_of(frame, *map(field, map(str, frame)))
