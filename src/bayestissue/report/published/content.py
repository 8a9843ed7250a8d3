"""The report's tables, and the sentences that are computed from them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.report.published.answers import QUANTITIES, spread
from bayestissue.report.published.run import PublishedRun
from bayestissue.report.tables import Row, Table, columns, lines
from bayestissue.report.wording import (
    UNITS,
    decimals_of,
    interval,
    listed,
    number,
    percent,
    probability,
    significant,
)
from bayestissue.reproduction.conditions import Quantity

_TAG = Markup('<span class="tag {}">{}</span>')
_SEVERITIES = ("major", "minor", "note")
_AGREES = {"true": ("yes", "agrees"), "false": ("no", "differs"), "": ("note-level", "not derivable")}


def _tag(kind: str, words: str) -> Markup:
    return _TAG.format(kind, words)


def severity_tag(severity: str) -> Markup:
    """The severity of a finding as a coloured word."""
    return _tag("note-level" if severity == "note" else severity, severity)


def agreement(run: PublishedRun) -> dict[str, int]:
    """How many published numbers were recomputed, agree, differ, fill a lost cell, and can't be derived."""
    answer = run.reproduction["agrees"].str.lower()
    counts = {name: int((answer == key).sum()) for key, name in (("true", "agree"), ("false", "differ"))}
    derived = int((run.reproduction["reproduced"] != "").sum())
    return {
        **counts,
        "derived": derived,
        "filled_in": derived - sum(counts.values()),
        "not_derived": len(run.reproduction) - derived,
        "all": len(run.reproduction),
    }


def reproduction_table(run: PublishedRun) -> Table:
    """Every published number beside the recomputed one."""
    rows = []
    for line in lines(run.reproduction):
        answer = str(line.agrees).lower()
        kind, words = _AGREES.get(answer, _AGREES[""])
        if answer == "" and line.reproduced:
            words = "not printed"
        shown = _shortened(str(line.reproduced))
        rows.append(
            Row(
                (line.table, line.row, line.quantity, line.published, shown, _tag(kind, words), line.note),
                "disagrees" if answer == "false" else "",
            )
        )
    titles = columns(
        *("table", "row", "quantity", "published", "reproduced", "agrees", "note"),
        number=("published", "reproduced"),
        words=("quantity", "note"),
    )
    return Table(titles, rows)


def _shortened(text: str) -> str:
    try:
        value = float(text)
    except ValueError:
        return text
    return significant(value, 6)


def severities(run: PublishedRun) -> str:
    """How many findings of which severity, in words."""
    counts = [(name, int((run.audit["severity"] == name).sum())) for name in _SEVERITIES]
    return listed([f"{count} {name}" for name, count in counts if count]) or "none"


def findings(run: PublishedRun) -> list[dict[str, str]]:
    """Every finding of the audit, worst first: the columns of `audit.csv`, a tag and an anchor."""
    return [
        {
            "anchor": f"finding-{line.Index + 1}",
            "tag": severity_tag(line.severity),
            "where": line.where,
            "what": line.what,
            "published": line.published,
            "implied": line.implied,
            "explanation": line.explanation,
        }
        for line in lines(run.audit)
    ]


def findings_by_severity(run: PublishedRun) -> dict[str, list[dict[str, str]]]:
    """`findings` under "major", "minor" and "note"; a severity without findings is left out."""
    every, severity = findings(run), run.audit["severity"]
    groups = {name: [every[place] for place in np.flatnonzero(severity == name)] for name in _SEVERITIES}
    return {name: group for name, group in groups.items() if group}


def hypotheses_table(run: PublishedRun) -> Table:
    """`hypotheses.csv`: the posterior probability that a mass exponent counts as 0, as 1, or as neither."""
    rows = [
        Row(
            (
                line.quantity,
                line.hypothesis,
                "" if math.isnan(line.value) else f"{line.value:g}",
                _region(line.rope_low, line.rope_high),
                probability(line.probability),
            )
        )
        for line in lines(run.hypotheses)
    ]
    titles = columns(
        *("quantity", "hypothesis", "exponent", "counts as equal", "probability"),
        number=("exponent", "counts as equal", "probability"),
    )
    return Table(titles, rows)


def _region(low: float, high: float) -> str:
    ends = (f"{low:g} to {high:g}", f"above {low:g}", f"below {high:g}", "")
    return ends[math.isnan(high) + 2 * math.isnan(low)].replace("-", "−")


def estimates_table(run: PublishedRun) -> Table:
    """Each published impact beside the posterior of that person in that condition."""
    cells = [run.labels("impact")]
    titles = ["impact"]
    for quantity in QUANTITIES:
        spreads = [spread(draws) for draws in run.draws(quantity).T]
        cells.append([significant(value, 5) for value in run.observed(f"{quantity}_observed")])
        cells.append([one.value for one in spreads])
        cells.append([one.range for one in spreads])
        titles += [f"published {quantity} ({UNITS[quantity]})", f"posterior {quantity}", f"{quantity}, 90 %"]
    return Table(columns(*titles, number=titles[1:]), [Row(row) for row in zip(*cells, strict=True)])


def summary_table(run: PublishedRun, variables: tuple[str, ...]) -> Table:
    """The rows of `summary.csv` for ``variables``, without the impacts' own."""
    chosen = run.summary[run.summary["variable"].isin(variables)]
    return Table(_SUMMARY_COLUMNS, [_summary_row(line) for _, line in chosen.iterrows()])


_SUMMARY_COLUMNS = columns(
    *("variable", "label", "unit", "median", "50 %", "90 %", "effective draws", "R̂"),
    number=("median", "50 %", "90 %", "effective draws", "R̂"),
)


def _summary_row(line: pd.Series) -> Row:
    places = decimals_of(line["eti90_high"] - line["eti90_low"])
    return Row(
        (
            line["variable"],
            line["label"],
            line["unit"],
            number(line["median"], places),
            interval(line["eti50_low"], line["eti50_high"], places),
            interval(line["eti90_low"], line["eti90_high"], places),
            number(line["ess_bulk"], 0),
            number(line["r_hat"], 3),
        )
    )


def lines_table(run: PublishedRun, printed: Mapping[Quantity, tuple[float, float] | None]) -> Table:
    """The thesis's regression lines over mass beside those through the posterior means."""
    rows = []
    for quantity in QUANTITIES:
        line = printed[quantity]
        for place, (name, per) in enumerate((("intercept", ""), ("slope", " per kg"))):
            variable = f"linear_{name}_{quantity}"
            if not run.has(variable):
                continue
            found = spread(run.draws(variable))
            rows.append(
                Row(
                    (
                        f"{name} of {quantity} ({UNITS[quantity]}{per})",
                        "" if line is None else f"{line[place]:g}".replace("-", "−"),
                        found.value,
                        found.range,
                        "" if line is None else "yes" if found.holds(line[place]) else "no",
                    )
                )
            )
    titles = ("straight line over mass", "thesis", "posterior", "90 %", "thesis inside")
    return Table(columns(*titles, number=titles[1:4]), rows)


def comparison_table(run: PublishedRun) -> Table:
    """`comparison.csv`: every competing explanation under both schemes of leaving out."""
    rows = [
        Row(
            (
                line.scheme,
                line.model,
                number(line.elpd, 1),
                number(line.se, 1),
                number(line.elpd_difference, 1),
                number(line.se_difference, 1),
                number(line.p_effective, 1),
                number(line.weight, 2),
                line.warning,
            )
        )
        for line in lines(run.comparison)
    ]
    titles = (
        "scheme",
        "model",
        "elpd",
        "se",
        "difference",
        "se of difference",
        "effective parameters",
        "weight",
    )
    return Table(columns(*titles, "warning", number=titles[2:], words=("warning",)), rows)


def sensitivity_table(run: PublishedRun) -> Table:
    """`sensitivity.csv`: how much each posterior moves when prior or likelihood is weighted up or down."""
    rows = [
        Row((line.variable, number(line.prior, 3), number(line.likelihood, 3), line.diagnosis))
        for line in lines(run.sensitivity)
    ]
    return Table(
        columns("variable", "prior", "likelihood", "diagnosis", number=("prior", "likelihood")), rows
    )


def checks_table(run: PublishedRun) -> Table:
    """`predictive_checks.csv`: statistics of the published numbers beside what the model predicts."""
    rows = [
        Row(
            (
                line.statistic,
                line.quantity,
                significant(line.observed, 4),
                significant(line.predicted_median, 4),
                interval(line.predicted_low, line.predicted_high),
                probability(line.p_value),
            ),
            "" if line.predicted_low <= line.observed <= line.predicted_high else "disagrees",
        )
        for line in lines(run.predictive_checks)
    ]
    titles = ("statistic", "quantity", "observed", "predicted", "90 %", "p")
    return Table(columns(*titles, number=titles[2:]), rows)


def diagnostics_table(run: PublishedRun) -> Table:
    """Every check of the sampler: value, limit, verdict, meaning and next step."""
    rows = [
        Row(
            (
                check["name"],
                _plain(check["value"]),
                _plain(check["limit"]),
                _tag("yes", "passed") if check["passed"] else _tag("no", "FAILED"),
                check["meaning"],
                check["next_step"] or "",
            ),
            "" if check["passed"] else "failed",
        )
        for check in run.diagnostics["checks"]
    ]
    titles = columns(
        *("check", "value", "limit", "verdict", "what it means", "next step"),
        number=("value", "limit"),
        words=("what it means", "next step"),
    )
    return Table(titles, rows)


def _plain(value: object) -> str:
    return significant(value, 4) if isinstance(value, float) else "" if value is None else str(value)


def shares(run: PublishedRun, kept: Mapping[Quantity, float]) -> str:
    """The kept shares of shrinkage in words, such as "3.2 % for K and 41 % for C"."""
    return listed([f"{percent(share)} for {quantity}" for quantity, share in kept.items()])
