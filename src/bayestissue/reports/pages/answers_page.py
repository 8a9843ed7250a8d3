"""Questions and predictions of a finished fit: on its first screen, and the pages of `ask` and `predict`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.base.outline import first_of
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.reports.figures.intervals import intervals
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.pages.page import part, render_page
from bayestissue.reports.pages.page_tables import Field, Table, over, shown, table_of
from bayestissue.reports.pages.wording import (
    FIRST_PREDICTED,
    PREDICTED,
    covariate_words,
    interval,
    names_in,
    nouns_of,
    predicted_words,
    probability,
    significant,
)

# As many as a first screen holds; the table has all.
FIRST = 6


def question_lines(answers: pd.DataFrame, most: int = FIRST) -> list[dict[str, str]]:
    """The first questions, each with its answer and what stands beside it in grey."""
    questions: list[list[dict[str, Any]]] = []
    for row in _rows(answers):
        # A choice has a row for each level.
        if row["level"] and questions and questions[-1][0]["question"] == row["question"]:
            questions[-1].append(row)
        else:
            questions.append([row])
    return [_line(rows) for rows in questions[:most]]


def _line(rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Of a question with a row, or of a choice with one for each level."""
    row = max(rows, key=lambda row: row["posterior"]) if len(rows) > 1 else rows[0]
    question = row["question"] if not row["name"] else f"{row['name'].replace('_', ' ')}: {row['question']}"
    if row["level"]:
        answer = f"{row['level']}, with probability {probability(row['posterior'])}"
        others = sorted((one for one in rows if one is not row), key=lambda row: -row["posterior"])
        chances = [f"{one['level']} {probability(one['posterior'])}" for one in others]
        detail = f"then {first_of(chances, FIRST)}; {row['level']} has {_value(row)}"
        detail += f" ({interval(row['low'], row['high'])})"
    elif pd.notna(row["posterior"]):
        answer = f"probability {probability(row['posterior'])}"
        detail = f"prior {probability(row['prior'])}" if pd.notna(row["prior"]) else row["note"]
    elif pd.notna(row["median"]):
        answer, detail = _value(row), interval(row["low"], row["high"])
    else:
        answer, detail = "no answer", row["note"].removeprefix("no answer: ")
    if ELEMENT_ALONE in row["note"] and ELEMENT_ALONE not in detail:
        detail = f"{detail}; {ELEMENT_ALONE}"
    return {"question": question, "answer": answer, "beside": detail}


def _value(row: Mapping[str, Any]) -> str:
    return f"{significant(row['median'])} {row['unit']}".rstrip()


def _rows(answers: pd.DataFrame) -> list[dict[str, Any]]:
    texts = {name: answers[name].astype(object).fillna("") for name in ("unit", "level")}
    return answers.assign(**texts).to_dict("records")  # type: ignore[return-value]


def answered(lines: Sequence[Mapping[str, str]], answers: pd.DataFrame, saved: str) -> Markup:
    """Questions that were typed on a page of a fit, with their answers, as a part of it.

    Args:
        lines: as `question_lines` has them, with the address of the page ``without`` each; of a question
            that is refused ``question`` and the ``problem``.
        answers: the table of those that have one.
        saved: address of that table.
    """
    known = (shown("questions", answers), _draws(answers)) if len(answers) else (None, "")
    return part("macros.html").answered(lines, *known, saved)


def _draws(table: pd.DataFrame) -> str:
    """How many draws a table of answers is by."""
    return f"{int(table['draws'].max()):,}"


MOST_DRAWN = 60


def questions_page(answers: pd.DataFrame, record: Mapping[str, Any]) -> str:
    """Every question with its answer, and all that is known of it in a table.

    Args:
        answers: as `bayestissue.inference.answers.questions.ask` answers.
        record: the content of the run's ``run.json``.
    """
    return render_page(
        "questions.html",
        nouns=nouns_of(record, names_in(answers)),
        record=record,
        questions=question_lines(answers, len(answers)),
        questions_table=shown("questions", answers),
        draws=_draws(answers),
    )


def predictions_page(predictions: pd.DataFrame, record: Mapping[str, Any]) -> str:
    """Every new impact with its predictions, drawn and in a table.

    Args:
        predictions: as `bayestissue.inference.answers.predictions.predict` makes them.
        record: the content of the run's ``run.json``.
    """
    first = predictions[:MOST_DRAWN]
    return render_page(
        "predictions.html",
        nouns=nouns_of(record, names_in(predictions)),
        record=record,
        figures=[drawn for name in FIRST_PREDICTED if (drawn := _intervals(first, name)) is not None],
        drawn=len(first),
        total=len(predictions),
        predictions=_table(predictions),
        draws=_draws(predictions),
    )


def _intervals(predictions: pd.DataFrame, name: str) -> Figure | None:
    """Median and 90 % interval of one quantity, a line a row; None where no row has it."""
    word, unit, factor = PREDICTED[name]
    median, low, high = (
        factor * predictions[f"{name}{end}"].to_numpy(float) for end in ("", "_low", "_high")
    )
    if not np.isfinite(median).any():
        return None
    labels = [
        f"{at}: {covariate_words(row) or 'the reference'}"
        for at, row in enumerate(predictions.to_dict("records"), start=1)
    ]
    rows = pd.DataFrame({"label": labels, "median": median, "eti90_low": low, "eti90_high": high})
    return intervals(
        rows, f"{word} ({unit})", f"{word} of each new impact in {unit}: median and 90 % interval."
    )


def _table(predictions: pd.DataFrame) -> Table:
    def quantity(name: str) -> Field:
        word, unit, _ = PREDICTED[name]
        return Field(f"{word}, {unit}", lambda row: over(*predicted_words(row[1], name)), "number")

    return table_of(
        enumerate(predictions.to_dict("records"), start=1),
        Field("row", lambda row: str(row[0]), "number"),
        Field("given", lambda row: _covariate_cell(row[1]), "words"),
        *(quantity(name) for name in PREDICTED if name in predictions),
    )


def _covariate_cell(row: Mapping[Any, Any]) -> Markup:
    """What was given, and under it what is new and what is to be known of it."""
    said = [f"new {row['new']}"] * bool(row["new"]) + [row["note"]] * bool(row["note"])
    return over(covariate_words(row), "; ".join(said))
