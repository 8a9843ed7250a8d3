"""Printed figures against each other, and against the rows and averages that they are made of."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from bayestissue.thesis.audit.inconsistencies import (
    Numbers,
    Publication,
    named_rows,
    number_list,
)
from bayestissue.thesis.reproduction.agreement import agrees, decimals, difference, half_unit, ratio
from bayestissue.thesis.reproduction.conditions import QUANTITIES, conditions, unrounded_mass
from bayestissue.thesis.reproduction.relations import straight_line

# Of a figure: a difference that is a note.
_SMALL = 0.01


def claims_that_contradict(publication: Publication) -> Iterator[Numbers]:
    """One figure stated in several places with different values.

    Minor: one of the figures must be wrong; a difference in the last digit is only a note.
    """
    by_figure = publication.tables.claims.groupby(["quantity", "statistic"], sort=False)
    for (quantity, statistic), claims in by_figure:
        values = claims.drop_duplicates("value")
        if len(values) < 2:
            continue
        low, high = values["value"].min(), values["value"].max()
        finest = values["value_text"].map(half_unit).astype("float64")
        if high - low <= finest.max() + finest.min() and finest.max() > finest.min():
            continue
        sections = claims.groupby("value_text", sort=False)["section"].unique().map(", ".join)
        implied = _recomputed(publication, claims)
        differ = f"by {_difference(low, high)}; at most one can be right."
        last_digit = high - low <= 2 * finest.max() + 1e-9
        yield {
            "sections": ", ".join(f"section {section}" for section in claims["section"].unique()),
            "quantity": quantity,
            "statistic": statistic,
            "texts": " and ".join(values["value_text"]),
            "one_value": implied or "one value",
            "said": "; ".join(f"{text} (section {sections[text]})" for text in values["value_text"]),
            "differ": "in the last digit only." if last_digit else differ,
            "recomputed": f" Recomputed from the tables it is {implied}." if implied else "",
            "severity": "note" if last_digit else "minor",
        }


def arithmetic_of_claims(publication: Publication) -> Iterator[Numbers]:
    """Range and ratio beside the smallest and largest value stated in the same section.

    A figure that the text gives with several values is left to `claims_that_contradict`, unless all of them
    disagree with the ends.

    Minor: the section refutes itself, whatever the data.
    """
    claims = publication.tables.claims
    values = dict(claims.groupby(["quantity", "statistic"])["value"].nunique())
    for (_, quantity), of_section in claims.groupby(["section", "quantity"], sort=False):
        said = {str(name): rows for name, rows in of_section.groupby("statistic")}
        for name, (low_name, high_name, rule) in _DERIVED.items():
            if not {name, low_name, high_name} <= set(said):
                continue
            low, high = said[low_name].iloc[0], said[high_name].iloc[0]
            implied, rounding = rule(*((end["value"], half_unit(end["value_text"])) for end in (low, high)))
            stated = said[name].drop_duplicates("value")
            slack = rounding + stated["value_text"].map(half_unit).astype("float64")
            wrong = stated[(stated["value"] - implied).abs() > slack + 1e-9]
            if wrong.empty or values[quantity, name] > len(stated):
                continue
            least = high["value"] / wrong["value"].iloc[0]
            needed = f" That ratio needs a smallest value of {least:.3g}." if rule is ratio else ""
            figures = {"figures": " and ".join(wrong["value_text"]), "implied": implied, "needed": needed}
            yield {"name": name, "low": low, "high": high, **figures}


# Of a statistic: the two ends that it follows from, and how.
_DERIVED = {
    "range": ("minimum", "maximum", difference),
    "ratio of maximum to minimum": ("minimum", "maximum", ratio),
    "range of trial averages": ("minimum of trial averages", "maximum of trial averages", difference),
    "ratio of trial averages": ("minimum of trial averages", "maximum of trial averages", ratio),
}


def _recomputed(publication: Publication, claims: pd.DataFrame) -> str:
    """The figure that the tables give for the first of ``claims``, with one digit more than the claim."""
    first = claims.iloc[0]
    lines = publication.reproduction
    line = lines[(lines["table"] == f"section {first['section']}") & (lines["row"] == first["claim"])]
    value = pd.to_numeric(line["reproduced"], errors="coerce").dropna()
    return "" if value.empty else f"{value.iloc[0]:.{claims['value_text'].map(decimals).max() + 1}f}"


def _difference(low: float, high: float) -> str:
    """In per cent of the smaller, or as a factor where that is large."""
    if low <= 0:
        return f"{high - low:.3g}"
    return f"a factor of {high / low:.2g}" if high > 1.5 * low else f"{high / low - 1:.1%}"


def figures_that_do_not_follow(publication: Publication) -> Iterator[Numbers]:
    """Figures that differ from the recomputed ones by more than one unit of the last digit.

    Masses are left to `kinetic_energy`, figures of the running text to `claims_that_contradict` where it
    gives several values; counts of variables are left out.

    Minor: the figure does not follow from its rows, though no conclusion rests on it; under 1 % is a
    note.
    """
    lines, claims = publication.reproduction, publication.tables.claims
    lines = lines[lines["agrees"].eq(False).fillna(False) & ~lines["quantity"].str.startswith("mass, trial")]
    lines = lines.assign(
        printed=pd.to_numeric(lines["published"], errors="coerce"),
        value=pd.to_numeric(lines["reproduced"], errors="coerce"),
    ).dropna(subset=["printed", "value"])
    unit = 2 * lines["published"].map(half_unit).astype("float64")
    last_digit = (lines["printed"] - lines["value"]).abs() <= unit + 1e-9
    several = claims.groupby(["quantity", "statistic"])["value"].transform("nunique") > 1
    elsewhere = claims.loc[several | claims["statistic"].str.startswith("number of"), "claim"]
    of_text = lines["table"].str.startswith("section")
    for row in named_rows(lines[~last_digit & ~(of_text & lines["row"].isin(elsewhere))]):
        words = {"place": _table_words(row.table), "hint": _hint(row.note)}
        implied = f"{row.value:.{decimals(row.published) + 1}f}"
        words["difference"] = _difference_words(row.printed, row.value)
        severity = "note" if abs(row.printed - row.value) < _SMALL * abs(row.value) else None
        yield {"row": row, "implied": implied, "severity": severity, **words}


def masses_behind_the_regression(publication: Publication) -> Iterator[Numbers]:
    """An equation that follows from E = ½MV² at higher velocities, not from the printed masses.

    Minor: it shows which masses the calculations were made with.
    """
    for quantity in QUANTITIES:
        terms, table = publication.equation(quantity)
        exact = unrounded_mass(table)
        printed, unrounded = (straight_line(table, mass).params["const"] for mass in (None, exact))
        text = terms[terms["term"] == "constant"].iloc[0]["coefficient_text"]
        if not agrees(text, printed) and agrees(text, unrounded):
            velocity = np.unique(np.sqrt(2 * table["energy_J"] / exact).round(6))
            constant = {"text": text, "printed": printed, "unrounded": unrounded}
            yield {"quantity": quantity, "velocities": number_list(velocity), **constant}


def impossible_spread(publication: Publication) -> Iterator[Numbers]:
    """A standard deviation that does not fit the range beside it, where the rows are lost.

    For n numbers of range R the standard deviation (with n − 1) lies between R/√(2(n − 1)) and
    R √(n/(n − 1))/2 (von Szőkefalvi Nagy 1918; Popoviciu 1935).

    Minor: no ten numbers have such a range and standard deviation.
    """
    for quantity in QUANTITIES:
        table = conditions(publication.tables, quantity)
        for _, row in table[~table["from_rows"]].iterrows():
            n = row["impacts"]
            slack = half_unit(row["sd_text"]) + half_unit(row["range_text"])
            low, high = row["range"] / (2 * (n - 1)) ** 0.5, row["range"] / 2 * (n / (n - 1)) ** 0.5
            if not low - slack <= row["sd"] <= high + slack:
                yield {"place": _table_words(row["table"]), "row": row, "low": low, "high": high}


def _table_words(table: str) -> str:
    """Where ``table`` of the reproduction stands, in words."""
    if table.startswith("equation"):
        return f"the {table}"
    return table if table.startswith("section") else f"Table {table}"


def _difference_words(printed: float, value: float) -> str:
    if value and not 0.5 < printed / value < 2:
        return f"{printed / value:.3g} times that"
    return f"{abs(printed - value):.3g} off" + (f" ({abs(printed / value - 1):.2%})" if value else "")


def _hint(note: str) -> str:
    hint = note.split(";")[0].strip()
    if hint.startswith("repeats"):
        return f" (it {hint})"
    return f" ({hint})" if "not cut" in hint else ""
