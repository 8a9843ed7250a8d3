"""Tables of the posterior, beside what was published."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pandas as pd

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


def shares(run: PublishedRun, kept: Mapping[Quantity, float]) -> str:
    """The kept shares of shrinkage in words, such as "3.2 % for K and 41 % for C"."""
    return listed([f"{percent(share)} for {quantity}" for quantity, share in kept.items()])
