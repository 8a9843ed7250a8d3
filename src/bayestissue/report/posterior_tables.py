"""Tables of a posterior and of what was checked about it, whatever data it came from."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import pandas as pd

from bayestissue.inference.results.meanings import SECANTS
from bayestissue.report.tables import Row, Table, columns, lines, tag
from bayestissue.report.wording import decimals_of, interval, number, probability, significant


def hypotheses_table(hypotheses: pd.DataFrame) -> Table:
    """`hypotheses.csv`: the posterior probability that a mass exponent counts as 0, as 1, or as neither."""
    rows = [
        Row(
            (
                SECANTS.get(line.quantity, line.quantity),
                line.hypothesis,
                "" if math.isnan(line.value) else f"{line.value:g}",
                _region(line.rope_low, line.rope_high),
                probability(line.probability),
            )
        )
        for line in lines(hypotheses)
    ]
    titles = columns(
        *("quantity", "hypothesis", "exponent", "counts as equal", "probability"),
        number=("exponent", "counts as equal", "probability"),
    )
    return Table(titles, rows)


def _region(low: float, high: float) -> str:
    ends = (f"{low:g} to {high:g}", f"above {low:g}", f"below {high:g}", "")
    return ends[math.isnan(high) + 2 * math.isnan(low)].replace("-", "−")


def summary_table(summary: pd.DataFrame, variables: Collection[str]) -> Table:
    """The rows of `summary.csv` for ``variables``, without the impacts' own."""
    chosen = summary[summary["variable"].isin(variables)]
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


def sensitivity_table(sensitivity: pd.DataFrame) -> Table:
    """`sensitivity.csv`: how much each posterior moves when prior or likelihood is weighted up or down."""
    rows = [
        Row((line.variable, number(line.prior, 3), number(line.likelihood, 3), line.diagnosis))
        for line in lines(sensitivity)
    ]
    return Table(
        columns("variable", "prior", "likelihood", "diagnosis", number=("prior", "likelihood")), rows
    )


def diagnostics_table(diagnostics: Mapping[str, Any]) -> Table:
    """Every check of the sampler: value, limit, verdict, meaning and next step."""
    rows = [
        Row(
            (
                check["name"],
                _plain(check["value"]),
                _plain(check["limit"]),
                tag("yes", "passed") if check["passed"] else tag("no", "FAILED"),
                check["meaning"],
                check["next_step"] or "",
            ),
            "" if check["passed"] else "failed",
        )
        for check in diagnostics["checks"]
    ]
    titles = columns(
        *("check", "value", "limit", "verdict", "what it means", "next step"),
        number=("value", "limit"),
        words=("what it means", "next step"),
    )
    return Table(titles, rows)


def _plain(value: object) -> str:
    return significant(value, 4) if isinstance(value, float) else "" if value is None else str(value)
