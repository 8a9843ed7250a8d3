"""Tables that hold the model to account: comparison, sensitivity, predictive checks, diagnostics."""

from __future__ import annotations

from bayestissue.report.published.run import PublishedRun
from bayestissue.report.tables import Row, Table, columns, lines
from bayestissue.report.wording import (
    interval,
    number,
    probability,
    significant,
)


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
