"""The pages of `bayestissue ask` and `bayestissue predict`: answers of a finished fit, to be kept or sent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.outline import counted
from bayestissue.report.fit.questions import question_lines, questions_table
from bayestissue.report.page import figure, render_page
from bayestissue.report.style import POSTERIOR, log_ticks, new_figure, style
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import PREDICTED, given_of, significant

MOST_DRAWN = 60
_MANY_FOLD = 3.0
_ENDS = ("", "_low", "_high")


def questions_page(asked: pd.DataFrame, about: Mapping[str, Any]) -> str:
    """Every question with its answer, and all that is known of it in a table.

    Args:
        asked: as `bayestissue.inference.answers.questions.ask` answers.
        about: the content of the run's ``run.json``.
    """
    return render_page(
        "questions.html",
        title=f"{counted(len(asked), 'question')} to a fit of {about['dataset']}",
        subtitle=_of(about),
        about=about,
        questions=question_lines(asked, len(asked)),
        questions_table=questions_table(asked),
        draws=f"{int(asked['draws'].max()):,}",
    )


def predictions_page(made: pd.DataFrame, about: Mapping[str, Any]) -> str:
    """Every new impact with its predictions, drawn and in a table.

    Args:
        made: as `bayestissue.inference.answers.predictions.predict` makes them.
        about: the content of the run's ``run.json``.
    """
    first = made[:MOST_DRAWN]
    return render_page(
        "predictions.html",
        title=f"{counted(len(made), 'new impact')} by a fit of {about['dataset']}",
        subtitle=_of(about),
        about=about,
        figures=[found for name in PREDICTED if (found := _intervals(first, name)) is not None],
        drawn=len(first),
        total=len(made),
        predictions=_table(made),
        draws=f"{int(made['draws'].max()):,}",
    )


def _of(about: Mapping[str, Any]) -> str:
    return f"by the model {about['model']['name']}, sampled {about['started'][:10]}"


def _intervals(made: pd.DataFrame, name: str) -> Markup | None:
    """Median and 90 % interval of one quantity, a line a row; None where no row has it."""
    word, unit, factor = PREDICTED[name]
    median, low, high = (factor * made[f"{name}{end}"].to_numpy(float) for end in _ENDS)
    if not np.isfinite(median).any():
        return None
    place = np.arange(1, len(made) + 1)
    with style():
        fig, axes = new_figure((4.8, 0.9 + 0.24 * max(len(made), 3)))
        axes.errorbar(median, place, xerr=[median - low, high - median], fmt="o", ms=4, color=POSTERIOR)
        axes.set(xlabel=f"{word} ({unit})", ylabel="row", ylim=(len(made) + 0.6, 0.4))
        axes.yaxis.get_major_locator().set_params(integer=True)
        axes.grid(axis="y", visible=False)
        ends = [*low[np.isfinite(low)], *high[np.isfinite(high)]]
        if min(ends) > 0 and max(ends) > _MANY_FOLD * min(ends):
            axes.set_xscale("log")
            log_ticks(axes.xaxis, ends)
        return figure(fig, f"{word} of each new impact in {unit}: median and 90 % interval.")


def _table(made: pd.DataFrame) -> Table:
    rows = [
        Row((str(number), _given(row), *(_cell(row, name) for name in PREDICTED)))
        for number, row in enumerate(made.to_dict("records"), start=1)
    ]
    titles = [f"{word}, {unit}" for word, unit, _ in PREDICTED.values()]
    return Table(columns("row", "given", *titles, number=("row", *titles), words=("given",)), rows)


def _given(row: Mapping[Any, Any]) -> Markup:
    """What was given, and under it what is new and what is to be known of it."""
    said = [f"new {row['new']}"] * bool(row["new"]) + [row["note"]] * bool(row["note"])
    return Markup('{}<br><span class="muted">{}</span>').format(given_of(row), "; ".join(said))


def _cell(row: Mapping[Any, Any], name: str) -> Markup | str:
    factor = PREDICTED[name][2]
    median, low, high = (factor * row[f"{name}{end}"] for end in _ENDS)
    if not np.isfinite(median):
        return ""
    shown = [significant(value) for value in (median, low, high)]
    return Markup('{}<br><span class="muted">{} to {}</span>').format(*shown)
