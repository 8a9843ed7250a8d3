"""Tables of a posterior and of what was checked about it, whatever data it came from."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import pandas as pd

from bayestissue.inference.results.meanings import SECANTS
from bayestissue.report.tables import Field, Table, lines, table_of, tag
from bayestissue.report.wording import decimals_of, interval, number, probability, significant


def hypotheses_table(hypotheses: pd.DataFrame) -> Table:
    """`hypotheses.csv`: the posterior probability that a mass exponent counts as 0, as 1, or as neither."""
    return table_of(
        lines(hypotheses),
        Field("quantity", lambda line: SECANTS.get(line.quantity, line.quantity)),
        Field("hypothesis", lambda line: line.hypothesis),
        Field("exponent", lambda line: "" if math.isnan(line.value) else f"{line.value:g}", "number"),
        Field("counts as equal", lambda line: _region(line.rope_low, line.rope_high), "number"),
        Field("probability", lambda line: probability(line.probability), "number"),
    )


def _region(low: float, high: float) -> str:
    ends = (f"{low:g} to {high:g}", f"above {low:g}", f"below {high:g}", "")
    return ends[math.isnan(high) + 2 * math.isnan(low)].replace("-", "−")


def summary_table(summary: pd.DataFrame, variables: Collection[str]) -> Table:
    """The rows of `summary.csv` for ``variables``, without the impacts' own."""

    def ends(line: Any, percent: int) -> str:
        low, high = (getattr(line, f"eti{percent}_{end}") for end in ("low", "high"))
        return interval(low, high, places(line))

    def places(line: Any) -> int:
        return decimals_of(line.eti90_high - line.eti90_low)

    return table_of(
        lines(summary[summary["variable"].isin(variables)]),
        Field("variable", lambda line: line.variable),
        Field("label", lambda line: line.label),
        Field("unit", lambda line: line.unit),
        Field("median", lambda line: number(line.median, places(line)), "number"),
        Field("50 %", lambda line: ends(line, 50), "number"),
        Field("90 %", lambda line: ends(line, 90), "number"),
        Field("effective draws", lambda line: number(line.ess_bulk, 0), "number"),
        Field("R̂", lambda line: number(line.r_hat, 3), "number"),
    )


def sensitivity_table(sensitivity: pd.DataFrame) -> Table:
    """`sensitivity.csv`: how much each posterior moves when prior or likelihood is weighted up or down."""
    return table_of(
        lines(sensitivity),
        Field("variable", lambda line: line.variable),
        Field("prior", lambda line: number(line.prior, 3), "number"),
        Field("likelihood", lambda line: number(line.likelihood, 3), "number"),
        Field("diagnosis", lambda line: line.diagnosis),
    )


def diagnostics_table(diagnostics: Mapping[str, Any]) -> Table:
    """Every check of the sampler: value, limit, verdict, meaning and next step."""
    return table_of(
        diagnostics["checks"],
        Field("check", lambda check: check["name"]),
        Field("value", lambda check: _plain(check["value"]), "number"),
        Field("limit", lambda check: _plain(check["limit"]), "number"),
        Field("verdict", lambda check: tag("yes", "passed") if check["passed"] else tag("no", "FAILED")),
        Field("what it means", lambda check: check["meaning"], "words"),
        Field("next step", lambda check: check["next_step"] or "", "words"),
        mark=lambda check: "" if check["passed"] else "failed",
    )


def _plain(value: object) -> str:
    return significant(value, 4) if isinstance(value, float) else "" if value is None else str(value)
