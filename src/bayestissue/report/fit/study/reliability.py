"""How repeatable a measurement of a person is: coefficients in a table, and what makes the error in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bayestissue.errors import Coded
from bayestissue.inference.answers.reliability import ICC, MDC, REPEATS, SEM
from bayestissue.inference.results.prior_overlap import MOSTLY
from bayestissue.report.fit.groupings import groupings
from bayestissue.report.fit.run import FitRun
from bayestissue.report.posterior import QUANTITIES, Spread
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import listed, number, percent

_PERCENT = "%"
# Of columns that tell days apart, in what labs call them.
_SESSIONS = ("session", "day", "date", "visit", "week", "occasion", "sitzung", "tag", "datum", "termin")


def reliability_table(run: FitRun) -> Table | None:
    """A row a coefficient, columns of K and C; None where the run has none."""
    if run.reliability is None or run.reliability.empty:
        return None
    units = {"N/m": "units", "N s/m": "units"}
    found = run.reliability.assign(unit=run.reliability["unit"].replace(units))
    cells = _by_place(found)
    rows = []
    for measure, form, unit in dict.fromkeys(key[1:] for key in cells):
        own = [_cells(cells.get((q, measure, form, unit))) for q in QUANTITIES]
        shown = {"units": "N/m, N s/m", "1": ""}.get(unit, unit)
        rows.append(Row((measure, form, shown, *(text for pair in own for text in pair))))
    titles = ("measure", "form", "unit", "K", "K, 90 %", "C", "C, 90 %")
    return Table(columns(*titles, number=titles[3:], words=titles[:1]), rows)


def _by_place(table: pd.DataFrame) -> dict[tuple[str, str, str, str], dict[Any, Any]]:
    """The rows by quantity, measure, form and unit."""
    names = ("quantity", "measure", "form", "unit")
    return {(*(str(row[name]) for name in names),): row for row in table.to_dict("records")}  # type: ignore[misc]


def _cells(row: dict[Any, Any] | None) -> tuple[str, str]:
    if row is None:
        return "", ""
    found = Spread(row["median"], row["low"], row["high"])
    if row["measure"] == REPEATS:
        return _whole(found.median), f"{_whole(found.low)} to {_whole(found.high)}"
    if found.low == found.high:
        return number(found.median, 2), "taken as known"
    return found.value, f"{found.range}{', largely prior' if _largely_prior(row) else ''}"


def _largely_prior(row: dict[Any, Any]) -> bool:
    # Runs of earlier versions don't say.
    return bool(row.get("prior_overlap", np.nan) > MOSTLY)


def prior_words(run: FitRun) -> str:
    """Which coefficients the data leave largely as the prior has them; empty where none."""
    if run.reliability is None or run.reliability.empty:
        return ""
    rows = [
        row
        for row in run.reliability.to_dict("records")
        if row["measure"] == ICC or (row["measure"] == SEM and row["unit"] == _PERCENT)
    ]
    told = [row for row in rows if _largely_prior(row)]
    if not told:
        return ""
    low, high = (percent(end(row["prior_overlap"] for row in told)) for end in (min, max))
    by = low if low == high else f"{low} to {high}"
    words = (
        f"Largely prior: of {listed([_name(row) for row in told])} these data say little, and the posterior "
        f"overlaps the prior of the model file by {by}, so that another prior would give another interval."
    )
    if not any(row["form"].startswith(("ICC(C", "consistency")) for row in told):
        words += " Agreement asks how conditions differ, of which few conditions say little."
    return words


def _name(row: dict[Any, Any]) -> str:
    form = str(row["form"]).split(", k")[0]
    return f"{form if row['measure'] == ICC else f'{SEM} ({form})'} of {row['quantity']}"


def _whole(value: float) -> str:
    return number(value, 0) if np.isfinite(value) else "no number"


def reliability_words(run: FitRun) -> list[str]:
    """The coefficients that answer how repeatable K and C are, in sentences."""
    if run.reliability is None or run.reliability.empty:
        return []
    cells = _by_place(run.reliability)
    sentences = []
    for q in QUANTITIES:
        error = [
            f"{words} {number(cells[q, SEM, form, _PERCENT]['median'], 1)}\N{NO-BREAK SPACE}%"
            for form, words in (("measuring chain", "the measuring chain makes"), ("person", "the person"))
        ]
        sentences.append(
            f"{q}: of one measurement {' and '.join(error)} of error (standard deviations). To show a change "
            f"(95\N{NO-BREAK SPACE}%) two measurements of a person must differ by {_changes(cells, q)}."
        )
        if (q, ICC, "ICC(A,1)", "1") in cells:
            icc = [_of(cells[q, ICC, f"ICC({form},1)", "1"]) for form in "CA"]
            need = _cells(cells[q, REPEATS, "ICC(A,k) of 0.9", "1"])
            one = "repeat" if need[0] == "1" else "repeats"
            sentences[-1] += (
                f" Its ICC(C,1) is {icc[0].value} ({icc[0].range}), its ICC(A,1) {icc[1].value} "
                f"({icc[1].range}); for an ICC(A,k) of 0.9 a person needs {need[0]} {one} ({need[1]})."
            )
    return sentences


def _changes(cells: dict[tuple[str, str, str, str], dict[Any, Any]], q: str) -> str:
    """The minimal detectable changes, each with what may vary between the two measurements."""
    found: dict[str, str] = {}
    for (of, measure, form, unit), row in cells.items():
        if (of, measure, unit) == (q, MDC, _PERCENT):
            name = str(form)
            change = _of(row)
            told = f"{change.value}\N{NO-BREAK SPACE}% ({change.range})"
            # Runs of earlier versions don't say what varies.
            varies = row.get("varies", "")
            varies = varies if isinstance(varies, str) else ""
            where = f"where {listed(varies.split(', '))} may differ" if varies else "all else the same"
            means = f" between {name.split(', ')[1]}" if ", " in name else ""
            found.setdefault(f"{where}{means}", told)
    return listed([f"{told} {where}" for where, told in found.items()])


def another_day(run: FitRun) -> str:
    """That repeats of one session say nothing of another day, where no group of the formula is a session."""
    if run.reliability is None or run.reliability.empty or any(map(_is_session, groupings(run))):
        return ""
    return Coded(
        "Repeats of one session say nothing of another day: no group of the formula is a session, so that "
        "what differs between days is in none of these numbers.",
        "one-session",
    )


def _is_session(grouping: str) -> bool:
    return any(word in grouping.lower() for word in _SESSIONS)


def _of(row: Any) -> Spread:
    return Spread(float(row["median"]), float(row["low"]), float(row["high"]))
