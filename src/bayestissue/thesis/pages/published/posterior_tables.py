"""Tables of the posterior, beside what was published."""

from __future__ import annotations

from collections.abc import Mapping

from bayestissue.report.posterior import QUANTITIES, spread
from bayestissue.report.tables import Row, Table, columns
from bayestissue.report.wording import (
    UNITS,
    listed,
    percent,
    significant,
)
from bayestissue.thesis.pages.published.run import PublishedRun
from bayestissue.thesis.reproduction.conditions import Quantity


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
