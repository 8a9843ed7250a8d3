"""Printed figures against what follows from the rows and averages they are made of."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from bayestissue.thesis.audit.findings import PUBLISHED, Finding, Publication, named_rows
from bayestissue.thesis.reproduction.agreement import agrees, decimals, half_unit
from bayestissue.thesis.reproduction.conditions import QUANTITIES, conditions, unrounded_mass
from bayestissue.thesis.reproduction.regressions import straight_line

_SMALL = 0.01


@PUBLISHED.check(
    severity="minor",
    bearing="tables",
    reason="the figure does not follow from its rows, though no conclusion rests on it; under 1 % is a note",
)
def figures_that_do_not_follow(publication: Publication) -> Iterator[Finding]:
    """Figures that differ from the recomputed ones by more than one unit of the last digit.

    Those of the running text are left to `claims_that_contradict` where it gives several values, and counts
    of variables to the checks in `significance` and `models`.
    """
    disagreements = _disagreements(publication)
    claims = publication.tables.claims
    several = claims.groupby(["quantity", "statistic"])["value"].transform("nunique") > 1
    elsewhere = claims.loc[several | claims["statistic"].str.startswith("number of"), "claim"]
    disagreements = disagreements[
        ~disagreements["last_digit"] & ~(disagreements["of_text"] & disagreements["row"].isin(elsewhere))
    ]
    for row in named_rows(disagreements):
        implied = f"{row.value:.{decimals(row.published) + 1}f}"
        yield Finding(
            table_words(row.table),
            row.quantity,
            row.published,
            implied,
            f"The figure for {row.quantity} in {table_words(row.table)} is {row.published}; recomputed from "
            f"the rows and averages it is {implied}, so the print is "
            f"{_difference_words(row.printed, row.value)}{_hint(row.note)}.",
            "note" if abs(row.printed - row.value) < _SMALL * abs(row.value) else None,
        )


@PUBLISHED.check(
    severity="note",
    bearing="tables",
    reason="nothing depends on the last digit, but a reader who recomputes it should know",
)
def last_digits(publication: Publication) -> Iterator[Finding]:
    """Figures of tables and equations one unit off in the last digit."""
    reproduction = publication.reproduction
    disagreements = _disagreements(publication)
    disagreements = disagreements[disagreements["last_digit"] & ~disagreements["of_text"]]
    if disagreements.empty:
        return
    compared = int((reproduction["agrees"].notna() & ~reproduction["table"].str.startswith("section")).sum())
    towards_zero = int((disagreements["printed"].abs() < disagreements["value"].abs()).sum())
    tables = {table_words(str(name)): len(rows) for name, rows in disagreements.groupby("table", sort=False)}
    yield Finding(
        ", ".join(tables),
        "last digits",
        f"{len(disagreements)} of {compared} figures",
        f"{towards_zero} too near to zero",
        f"{len(disagreements)} of the {compared} figures in tables and equations that can be recomputed are "
        "one unit off in the last digit "
        f"({', '.join(f'{count} in {name}' for name, count in tables.items())}), {towards_zero} of them "
        "towards zero: digits were cut off where they should have been rounded.",
    )


@PUBLISHED.check(
    severity="minor",
    bearing="inputs",
    reason="it shows which masses the calculations were made with",
)
def masses_behind_the_regression(publication: Publication) -> Iterator[Finding]:
    """An equation that follows from E = ½MV² at higher velocities, not from the printed masses."""
    for quantity in QUANTITIES:
        terms = publication.tables.regressions.query("quantity == @quantity")
        table = conditions(publication.tables, quantity)
        exact = unrounded_mass(table)
        if exact is None:
            return
        printed, unrounded = (
            straight_line(table, mass).params["const"] for mass in (table["mass_kg"], exact)
        )
        constant = terms[terms["term"] == "constant"].iloc[0]
        text = constant["coefficient_text"]
        if agrees(text, printed) or not agrees(text, unrounded):
            continue
        velocity = np.unique(np.sqrt(2 * table["energy_J"] / exact).round(6))
        yield Finding(
            "section 5.4, Table 5.10",
            f"masses in the equation of {quantity}",
            f"constant {text}",
            f"{unrounded:.4f}, or {printed:.4f} with the printed masses",
            f"The constant of the equation of {quantity}, {text}, follows from masses 2E/V² with V = "
            f"{', '.join(f'{value:g}' for value in velocity)} m/s ({unrounded:.4f}), not from the printed "
            f"masses, which are those cut off after three decimals ({printed:.4f}), and not from the "
            "velocities printed beside them.",
        )


@PUBLISHED.check(
    severity="minor",
    bearing="tables",
    reason="no ten numbers have such a range and standard deviation",
)
def impossible_spread(publication: Publication) -> Iterator[Finding]:
    """A standard deviation that does not fit the range beside it, where the rows are lost.

    For n numbers of range R the standard deviation (with n − 1) lies between R/√(2(n − 1)) and
    R √(n/(n − 1))/2 (von Szőkefalvi Nagy 1918; Popoviciu 1935).
    """
    for quantity in QUANTITIES:
        table = conditions(publication.tables, quantity)
        for trial, row in table[~table["from_rows"]].iterrows():
            n = row["impacts"]
            slack = half_unit(row["sd_text"]) + half_unit(row["range_text"])
            low, high = row["range"] / (2 * (n - 1)) ** 0.5, row["range"] / 2 * (n / (n - 1)) ** 0.5
            if low - slack <= row["sd"] <= high + slack:
                continue
            yield Finding(
                table_words(row["table"]),
                f"spread of {quantity}, trial {trial}",
                f"sd {row['sd_text']}, range {row['range_text']}",
                f"sd from {low:.3f} to {high:.3f}",
                f"{n:.0f} numbers with a range of {row['range_text']} have a standard deviation between "
                f"{low:.3f} and {high:.3f}; for {quantity} in trial {trial} {row['sd_text']} is printed.",
            )


@PUBLISHED.check(
    severity="note", bearing="tables", reason="it hides how exactly the figures were known, no more"
)
def uneven_digits(publication: Publication) -> Iterator[Finding]:
    """Columns whose figures are printed with different numbers of decimals."""
    tables = publication.tables
    for frame, columns in ((tables.estimates, ("K", "C")), (tables.averages, ("average", "sd", "range"))):
        for table, rows in frame.groupby("table", sort=False):
            for column in columns:
                digits = rows[f"{column}_text"].map(decimals)
                usual = int(digits.mode().iloc[0])
                odd = rows.loc[digits != usual, f"{column}_text"]
                if odd.empty:
                    continue
                yield Finding(
                    table_words(str(table)),
                    f"digits of the column {column}",
                    ", ".join(odd),
                    f"{usual} decimals",
                    f"The column {column} has {usual} decimals, except for {', '.join(odd)}.",
                )


def _disagreements(publication: Publication) -> pd.DataFrame:
    """The numeric disagreements of the reproduction, without the masses, which `kinetic_energy` explains.

    Added are ``printed`` and ``value`` as numbers, ``last_digit`` (no more than one unit of the last printed
    digit off) and ``of_text`` (the running text, not a table).
    """
    lines = publication.reproduction
    lines = lines[lines["agrees"].eq(False).fillna(False) & ~lines["quantity"].str.startswith("mass, trial")]
    lines = lines.assign(
        printed=pd.to_numeric(lines["published"], errors="coerce"),
        value=pd.to_numeric(lines["reproduced"], errors="coerce"),
        of_text=lines["table"].str.startswith("section"),
    ).dropna(subset=["printed", "value"])
    unit = 2 * lines["published"].map(half_unit).astype("float64")
    return lines.assign(last_digit=(lines["printed"] - lines["value"]).abs() <= unit + 1e-9)


def table_words(table: str) -> str:
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
