"""The tables of the page on causes."""

from __future__ import annotations

from markupsafe import Markup

from bayestissue.causes.statistics import MEANING, WORDS
from bayestissue.report.causes.answers import failing, p_words
from bayestissue.report.causes.figures import short
from bayestissue.report.causes.run import CausesRun
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import number, significant

_VERDICTS = {"refuted": "ruled out", "doubtful": "hardly", "possible": "possible"}


def causes_table(run: CausesRun) -> Table:
    """One row a cause."""
    rows = [
        Row(
            (
                row["title"],
                _VERDICTS.get(row["verdict"], row["verdict"]),
                p_words(row),
                f"{number(row['probability'], 3)} ± {number(row['probability_error'], 3)}",
                failing(row) or "none by itself",
                row["nearest"].replace("_m_s ", " in m/s ").replace("_", " ") or "has no strength",
            ),
            "disagrees" if row["verdict"] == "refuted" else "",
        )
        for row in run.causes.to_dict("records")
    ]
    titles = ("cause", "alone", "joint p", "posterior", "misses most", "strength of the nearest campaigns")
    return Table(
        columns(*titles, number=("joint p", "posterior"), words=("cause", titles[4], titles[5])), rows
    )


def statistics_table(run: CausesRun) -> Table:
    """What each statistic is, and its observed value."""
    rows = [
        Row(
            (
                WORDS[name],
                significant(run.value(name)),
                "yes" if name in run.compared else "no",
                MEANING[name],
            )
        )
        for name in run.statistics
    ]
    titles = ("number", "observed", "compared", "what it is")
    return Table(columns(*titles, number=("observed",), words=("what it is",)), rows)


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
    rows = [
        Row(
            (
                row["title"],
                number(row["campaigns"], 0),
                number(row["complete"], 3),
                number(row["calibration_below_10"], 3),
                number(row["calibration_below_50"], 3),
                number((0.09 * 2 / max(row["calibration_campaigns"], 1)) ** 0.5, 3),
                number(row["calibration_p"], 2),
            )
        )
        for row in run.causes.to_dict("records")
    ]
    titles = ("cause", "campaigns", "with all statistics", "p ≤ 0.1", "p ≤ 0.5", "± at 0.1", "uniform: p")
    return Table(columns(*titles, number=titles[1:], words=("cause",)), rows)


def reliability_table(run: CausesRun) -> Table:
    """Probabilities given, and how often they were right."""
    rows = [
        Row((number(row["probability"], 3), number(row["right"], 3), number(row["cases"], 0)))
        for row in run.reliability.to_dict("records")
    ]
    titles = ("probability given", "share that was right", "cases")
    return Table(columns(*titles, number=titles), rows)
