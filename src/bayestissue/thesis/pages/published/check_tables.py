"""Tables that hold the model to account: comparison, sensitivity, predictive checks, diagnostics."""

from __future__ import annotations

from bayestissue.report.tables import Field, Table, lines, table_of
from bayestissue.report.wording import interval, number, probability, significant
from bayestissue.thesis.pages.published.run import PublishedRun


def comparison_table(run: PublishedRun) -> Table:
    """`comparison.csv`: every competing explanation under both schemes of leaving out."""
    return table_of(
        lines(run.comparison),
        Field("scheme", lambda line: line.scheme),
        Field("model", lambda line: line.model),
        Field("elpd", lambda line: number(line.elpd, 1), "number"),
        Field("se", lambda line: number(line.se, 1), "number"),
        Field("difference", lambda line: number(line.elpd_difference, 1), "number"),
        Field("se of difference", lambda line: number(line.se_difference, 1), "number"),
        Field("effective parameters", lambda line: number(line.p_effective, 1), "number"),
        Field("weight", lambda line: number(line.weight, 2), "number"),
        Field("warning", lambda line: line.warning, "words"),
    )


def checks_table(run: PublishedRun) -> Table:
    """`predictive_checks.csv`: statistics of the published numbers beside what the model predicts."""
    return table_of(
        lines(run.predictive_checks),
        Field("statistic", lambda line: line.statistic),
        Field("quantity", lambda line: line.quantity),
        Field("observed", lambda line: significant(line.observed, 4), "number"),
        Field("predicted", lambda line: significant(line.predicted_median, 4), "number"),
        Field("90 %", lambda line: interval(line.predicted_low, line.predicted_high), "number"),
        Field("p", lambda line: probability(line.p_value), "number"),
        mark=lambda line: "" if line.predicted_low <= line.observed <= line.predicted_high else "disagrees",
    )
