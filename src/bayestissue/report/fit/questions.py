"""Questions and their answers: on the first screen of a fit, and on a page of their own."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import interval, number, probability, significant

# As many as a first screen holds; the table has all.
FIRST = 6
_TITLES = (
    "name",
    "question",
    "posterior",
    "prior",
    "Bayes factor",
    "Monte Carlo error",
    "median",
    "90 % interval",
    "unit",
    "note",
)
_NUMBERS = _TITLES[2:-2]


def question_lines(asked: pd.DataFrame | None, most: int = FIRST) -> list[dict[str, str]]:
    """The first questions, each with its answer and what stands beside it in grey."""
    return [_line(row) for row in _rows(asked)[:most]]


def _line(row: dict[str, Any]) -> dict[str, str]:
    asked = row["question"] if not row["name"] else f"{row['name'].replace('_', ' ')}: {row['question']}"
    if pd.notna(row["posterior"]):
        answer = f"probability {probability(row['posterior'])}"
        beside = f"before the data {probability(row['prior'])}" if pd.notna(row["prior"]) else row["note"]
    elif pd.notna(row["median"]):
        answer = f"{significant(row['median'])} {row['unit']}".rstrip()
        beside = interval(row["low"], row["high"])
    else:
        answer, beside = "no answer", row["note"].removeprefix("no answer: ")
    return {"question": asked, "answer": answer, "beside": beside}


def questions_table(asked: pd.DataFrame | None) -> Table:
    """Every question with all that is known of its answer, without columns that are empty in all of them."""
    cells = [_cells(row) for row in _rows(asked)]
    kept = [
        place for place, title in enumerate(_TITLES) if title == "question" or any(c[place] for c in cells)
    ]
    return Table(
        columns(*(_TITLES[place] for place in kept), number=_NUMBERS, words=("question", "unit", "note")),
        [Row([row[place] for place in kept]) for row in cells],
    )


def _cells(row: dict[str, Any]) -> list[str]:
    def shown(value: float, words: str) -> str:
        return words if pd.notna(value) else ""

    return [
        row["name"].replace("_", " "),
        row["question"],
        shown(row["posterior"], number(row["posterior"], 3)),
        shown(row["prior"], number(row["prior"], 3)),
        shown(row["bayes_factor"], significant(row["bayes_factor"])),
        shown(row["mcse"], significant(row["mcse"], 2)),
        shown(row["median"], significant(row["median"], 4)),
        shown(row["low"], interval(row["low"], row["high"])),
        row["unit"],
        row["note"],
    ]


def _rows(asked: pd.DataFrame | None) -> list[dict[str, Any]]:
    if asked is None:
        return []
    # Tables of older runs have no units.
    unit = asked["unit"].fillna("") if "unit" in asked else ""
    return asked.assign(unit=unit).to_dict("records")  # type: ignore[return-value]
