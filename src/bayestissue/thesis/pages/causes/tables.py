"""The tables of the page on causes."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup

from bayestissue.report.tables import Field, Row, Table, columns, table_of
from bayestissue.report.wording import number, significant
from bayestissue.thesis.causes.statistics import MEANING, WORDS
from bayestissue.thesis.pages.causes.answers import failing, p_words
from bayestissue.thesis.pages.causes.figures import short
from bayestissue.thesis.pages.causes.run import CausesRun

_VERDICTS = {"refuted": "ruled out", "doubtful": "hardly", "possible": "possible"}


def causes_table(run: CausesRun) -> Table:
    """One row a cause."""
    return table_of(
        run.causes.to_dict("records"),
        Field("cause", lambda row: row["title"], "words"),
        Field("alone", lambda row: _VERDICTS.get(row["verdict"], row["verdict"])),
        Field("joint p", p_words, "number"),
        Field("posterior", _posterior, "number"),
        Field("misses most", lambda row: failing(row) or "none by itself", "words"),
        Field("strength of the nearest campaigns", _strength, "words"),
        mark=lambda row: "disagrees" if row["verdict"] == "refuted" else "",
    )


def _posterior(row: dict[str, Any]) -> str:
    return f"{number(row['probability'], 3)} ± {number(row['probability_error'], 3)}"


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
    names = list(run.causes["cause"])
    rows = []
    for statistic in run.statistics:
        cells = [number(value, 3) for value in run.causes[f"p_{statistic}"]]
        rows.append(Row((WORDS[statistic], significant(run.value(statistic)), *cells)))
    heads = [short(name) for name in names]
    return Table(
        columns("statistic", "observed", *heads, number=("observed", *heads), words=("statistic",)), rows
    )


def confusion_table(run: CausesRun) -> Table:
    """Mean probability given to each cause by campaigns of each; what a cause gives itself is bold."""
    names = list(run.confusion["truth"])
    rows = []
    for row in run.confusion.to_dict("records"):
        cells = [
            Markup("<b>{}</b>").format(number(row[name], 2)) if name == row["truth"] else _small(row[name])
            for name in names
        ]
        rows.append(Row((short(row["truth"]), *cells)))
    heads = [short(name) for name in names]
    return Table(columns("made by", *heads, number=heads), rows)


def _small(value: float) -> str:
    return number(value, 2) if value >= 0.005 else ""


def calibration_table(run: CausesRun) -> Table:
    """How often p-values of a cause's own campaigns were at most 0.1 and 0.5."""
    return table_of(
        run.causes.to_dict("records"),
        Field("cause", lambda row: row["title"], "words"),
        Field("campaigns", lambda row: number(row["campaigns"], 0), "number"),
        Field("with all statistics", lambda row: number(row["complete"], 3), "number"),
        Field("p ≤ 0.1", lambda row: number(row["calibration_below_10"], 3), "number"),
        Field("p ≤ 0.5", lambda row: number(row["calibration_below_50"], 3), "number"),
        Field("± at 0.1", lambda row: number(_error_at_10(row["calibration_campaigns"]), 3), "number"),
        Field("uniform: p", lambda row: number(row["calibration_p"], 2), "number"),
    )


def _error_at_10(campaigns: float) -> float:
    return (0.09 * 2 / max(campaigns, 1)) ** 0.5


def reliability_table(run: CausesRun) -> Table:
    """Probabilities given, and how often they were right."""
    return table_of(
        run.reliability.to_dict("records"),
        Field("probability given", lambda row: number(row["probability"], 3), "number"),
        Field("share that was right", lambda row: number(row["right"], 3), "number"),
        Field("cases", lambda row: number(row["cases"], 0), "number"),
    )
