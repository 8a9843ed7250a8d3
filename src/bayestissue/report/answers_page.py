"""Questions and predictions of a finished fit: on its first screen, and the pages of `ask` and `predict`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.outline import counted
from bayestissue.report.page import figure, render_page
from bayestissue.report.style import POSTERIOR, log_ticks, new_figure, style
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import PREDICTED, covariate_words, interval, number, probability, significant

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


def question_lines(answers: pd.DataFrame | None, most: int = FIRST) -> list[dict[str, str]]:
    """The first questions, each with its answer and what stands beside it in grey."""
    return [_line(row) for row in _rows(answers)[:most]]


def _line(row: dict[str, Any]) -> dict[str, str]:
    question = row["question"] if not row["name"] else f"{row['name'].replace('_', ' ')}: {row['question']}"
    if pd.notna(row["posterior"]):
        answer = f"probability {probability(row['posterior'])}"
        detail = f"before the data {probability(row['prior'])}" if pd.notna(row["prior"]) else row["note"]
    elif pd.notna(row["median"]):
        answer = f"{significant(row['median'])} {row['unit']}".rstrip()
        detail = interval(row["low"], row["high"])
    else:
        answer, detail = "no answer", row["note"].removeprefix("no answer: ")
    return {"question": question, "answer": answer, "beside": detail}


def questions_table(answers: pd.DataFrame | None) -> Table:
    """Every question with all that is known of its answer, without columns that are empty in all of them."""
    cells = [_cells(row) for row in _rows(answers)]
    present = [
        column for column, title in enumerate(_TITLES) if title == "question" or any(c[column] for c in cells)
    ]
    return Table(
        columns(
            *(_TITLES[column] for column in present), number=_NUMBERS, words=("question", "unit", "note")
        ),
        [Row([row[column] for column in present]) for row in cells],
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


def _rows(answers: pd.DataFrame | None) -> list[dict[str, Any]]:
    if answers is None:
        return []
    # Tables of older runs have no units.
    unit = answers["unit"].fillna("") if "unit" in answers else ""
    return answers.assign(unit=unit).to_dict("records")  # type: ignore[return-value]


MOST_DRAWN = 60
_MANY_FOLD = 3.0
_ENDS = ("", "_low", "_high")


def questions_page(answers: pd.DataFrame, record: Mapping[str, Any]) -> str:
    """Every question with its answer, and all that is known of it in a table.

    Args:
        answers: as `bayestissue.inference.answers.questions.ask` answers.
        record: the content of the run's ``run.json``.
    """
    return render_page(
        "questions.html",
        title=f"{counted(len(answers), 'question')} to a fit of {record['dataset']}",
        subtitle=_model_words(record),
        record=record,
        questions=question_lines(answers, len(answers)),
        questions_table=questions_table(answers),
        draws=f"{int(answers['draws'].max()):,}",
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
        title=f"{counted(len(predictions), 'new impact')} by a fit of {record['dataset']}",
        subtitle=_model_words(record),
        record=record,
        figures=[drawn for name in PREDICTED if (drawn := _intervals(first, name)) is not None],
        drawn=len(first),
        total=len(predictions),
        predictions=_table(predictions),
        draws=f"{int(predictions['draws'].max()):,}",
    )


def _model_words(record: Mapping[str, Any]) -> str:
    return f"by the model {record['model']['name']}, sampled {record['started'][:10]}"


def _intervals(predictions: pd.DataFrame, name: str) -> Markup | None:
    """Median and 90 % interval of one quantity, a line a row; None where no row has it."""
    word, unit, factor = PREDICTED[name]
    median, low, high = (factor * predictions[f"{name}{end}"].to_numpy(float) for end in _ENDS)
    if not np.isfinite(median).any():
        return None
    row = np.arange(1, len(predictions) + 1)
    with style():
        fig, axes = new_figure((4.8, 0.9 + 0.24 * max(len(predictions), 3)))
        axes.errorbar(median, row, xerr=[median - low, high - median], fmt="o", ms=4, color=POSTERIOR)
        axes.set(xlabel=f"{word} ({unit})", ylabel="row", ylim=(len(predictions) + 0.6, 0.4))
        axes.yaxis.get_major_locator().set_params(integer=True)
        axes.grid(axis="y", visible=False)
        ends = [*low[np.isfinite(low)], *high[np.isfinite(high)]]
        if min(ends) > 0 and max(ends) > _MANY_FOLD * min(ends):
            axes.set_xscale("log")
            log_ticks(axes.xaxis, ends)
        return figure(fig, f"{word} of each new impact in {unit}: median and 90 % interval.")


def _table(predictions: pd.DataFrame) -> Table:
    rows = [
        Row((str(number), _covariate_cell(row), *(_cell(row, name) for name in PREDICTED)))
        for number, row in enumerate(predictions.to_dict("records"), start=1)
    ]
    titles = [f"{word}, {unit}" for word, unit, _ in PREDICTED.values()]
    return Table(columns("row", "given", *titles, number=("row", *titles), words=("given",)), rows)


def _covariate_cell(row: Mapping[Any, Any]) -> Markup:
    """What was given, and under it what is new and what is to be known of it."""
    said = [f"new {row['new']}"] * bool(row["new"]) + [row["note"]] * bool(row["note"])
    return Markup('{}<br><span class="muted">{}</span>').format(covariate_words(row), "; ".join(said))


def _cell(row: Mapping[Any, Any], name: str) -> Markup | str:
    factor = PREDICTED[name][2]
    median, low, high = (factor * row[f"{name}{end}"] for end in _ENDS)
    if not np.isfinite(median):
        return ""
    shown = [significant(value) for value in (median, low, high)]
    return Markup('{}<br><span class="muted">{} to {}</span>').format(*shown)
