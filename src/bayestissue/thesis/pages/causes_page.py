"""The page of a test of causes, with its figures and tables."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.figures.intervals import ENDS, intervals, with_error_of
from bayestissue.figures.theme import Figure
from bayestissue.report import tables
from bayestissue.report.page import render_page
from bayestissue.report.tables import Field, Row, Table, columns, number_field, table_of
from bayestissue.report.wording import decimals, number, significant, with_error
from bayestissue.thesis.causes.design import LEVEL, MEANING, WORDS
from bayestissue.thesis.pages import causes_answers
from bayestissue.thesis.pages.causes_answers import CausesRun, failing, p_words, read_causes_run


def short(name: str) -> str:
    """A cause's name in the specification as a label."""
    return name.replace("_", " ")


def predictive_figures(run: CausesRun) -> list[Figure]:
    """One for each statistic that is drawn."""
    return [_predictive_figure(run, name) for name in run.statistics]


def _predictive_figure(run: CausesRun, statistic: str) -> Figure:
    """One statistic: 90 % and 50 % of each cause's campaigns, their median, and the observed value."""
    names = list(run.causes["cause"])
    rows = run.predictive[run.predictive["statistic"] == statistic].set_index("cause").loc[names]
    ends = dict(zip(("q05", "q25", "q50", "q75", "q95"), ENDS, strict=True))
    observed = run.value(statistic)
    return intervals(
        rows.rename(columns=ends)[list(ENDS)].reset_index(drop=True).assign(label=list(map(short, names))),
        WORDS[statistic],
        f"{WORDS[statistic]}: for each cause the range of nine tenths and of one half of its campaigns; "
        f"a dashed line at the observed value, {observed:.3g}.",
        lines=(observed,),
        straight=statistic != LEVEL,
    )


def probability_figures(run: CausesRun) -> list[Figure]:
    """Posterior probability and joint p-value of every cause."""
    table = run.causes
    names = table["cause"].map(short)
    return [
        intervals(
            with_error_of(names, table["probability"], table["probability_error"]),
            "posterior probability among these causes",
            "The posterior probability of every cause with its Monte Carlo error.",
            domain=(0, 1),
            straight=True,
        ),
        intervals(
            pd.DataFrame({"label": names, "value": table["p_joint"]}),
            "joint predictive p-value",
            "The joint predictive p-value of every cause on a logarithmic scale, with a dashed line at 0.01.",
            lines=(0.01,),
            domain=(min(float(table["smallest_p"].min()) * 0.6, 0.005), 1.0),
        ),
    ]


_VERDICTS = {"refuted": "ruled out", "doubtful": "hardly", "possible": "possible"}


def causes_table(run: CausesRun) -> Table:
    """One row a cause."""
    return table_of(
        run.causes,
        Field("cause", "title", "words"),
        Field("alone", lambda row: _VERDICTS.get(row["verdict"], row["verdict"])),
        Field("joint p", p_words, "number"),
        Field(
            "posterior",
            lambda row: with_error(row["probability"], row["probability_error"], 3),
            "number",
        ),
        Field("misses most", lambda row: failing(row) or "none by itself", "words"),
        Field("strength of the nearest campaigns", _strength, "words"),
        mark=lambda row: "disagrees" if row["verdict"] == "refuted" else "",
    )


def _strength(row: dict[str, Any]) -> str:
    return row["nearest"].replace("_m_s ", " in m/s ").replace("_", " ") or "has no strength"


def statistics_table(run: CausesRun) -> Table:
    """What each statistic is, and its observed value."""
    return table_of(
        run.statistics,
        Field("number", WORDS.__getitem__),
        Field("observed", lambda name: significant(run.value(name)), "number"),
        Field("compared", lambda name: "yes" if name in run.compared else "no"),
        Field("what it is", MEANING.__getitem__, "words"),
    )


def p_table(run: CausesRun) -> Table:
    """The p-value of every statistic under every cause."""
    rows = [
        Row((WORDS[name], significant(run.value(name)), *(number(p, 3) for p in run.causes[f"p_{name}"])))
        for name in run.statistics
    ]
    numbers = ("observed", *map(short, run.causes["cause"]))
    return Table(columns("statistic", *numbers, number=numbers, words=("statistic",)), rows)


def confusion_table(run: CausesRun) -> Table:
    """Mean probability given to each cause by campaigns of each; what a cause gives itself is bold."""
    names = list(run.confusion["truth"])
    rows = []
    for row in run.confusion.to_dict("records"):
        cells = [number(row[name], 2) if row[name] >= 0.005 else "" for name in names]
        cells[names.index(row["truth"])] = Markup("<b>{}</b>").format(number(row[row["truth"]], 2))
        rows.append(Row((short(row["truth"]), *cells)))
    heads = list(map(short, names))
    return Table(columns("made by", *heads, number=heads), rows)


def calibration_table(run: CausesRun) -> Table:
    """How often p-values of a cause's own campaigns were at most 0.1 and 0.5."""
    # Of so many independent campaigns, the standard error of a share of a tenth, twice.
    error = np.sqrt(2 * 0.1 * 0.9 / run.causes["calibration_campaigns"].clip(lower=1))
    return table_of(
        run.causes.assign(error=error),
        Field("cause", "title", "words"),
        number_field("campaigns", words=decimals(0)),
        number_field("with all statistics", "complete", decimals(3)),
        number_field("p ≤ 0.1", "calibration_below_10", decimals(3), "not known"),
        number_field("p ≤ 0.5", "calibration_below_50", decimals(3), "not known"),
        number_field("± at 0.1", "error", decimals(3)),
        number_field("uniform: p", "calibration_p", decimals(2), "not known"),
    )


def reliability_table(run: CausesRun) -> Table:
    """Probabilities given, and how often they were right."""
    return table_of(
        run.reliability,
        number_field("probability given", "probability", decimals(3)),
        number_field("share that was right", "right", decimals(3)),
        number_field("cases", words=decimals(0)),
    )


def causes_page(folder: Path, record: dict[str, Any]) -> str:
    """The HTML of the run in ``folder``, whose ``run.json`` holds ``record``.

    Raises:
        InputError: a file lacks or isn't what `bayestissue causes` writes.
    """
    run = read_causes_run(folder, record)
    return render_page(
        "causes.html",
        page=sys.modules[__name__],
        answers=causes_answers,
        tables=tables,
        record=record,
        run=run,
    )
