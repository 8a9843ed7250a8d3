"""How the thesis's method, the exact point fit and the posterior agree, as Bland and Altman plot it."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.inference.answers.agreement import METHODS, agreement, log_ratios
from bayestissue.report.fit.estimates import shown_rows, side_by_side
from bayestissue.report.fit.run import FitRun
from bayestissue.report.page import figure
from bayestissue.report.posterior import QUANTITIES
from bayestissue.report.style import MUTED, POSTERIOR, REFERENCE, log_ticks, new_figure, style
from bayestissue.report.tables import Field, Table, lines, table_of
from bayestissue.report.wording import UNITS, interval, significant

_MANY_FOLD = 3.0


def values_of(run: FitRun, quantity: str) -> pd.DataFrame:
    """Of each impact the value by every method, [impact, method]."""
    return side_by_side(run, quantity).rename(columns={"median": "posterior"})[list(METHODS)]


def agreement_table(run: FitRun) -> Table:
    """The ratio of each method to each other with its limits of agreement."""
    found = agreement({quantity: values_of(run, quantity) for quantity in QUANTITIES})
    return table_of(
        lines(found),
        Field("quantity", lambda line: line.quantity),
        Field("methods", lambda line: f"{METHODS[line.method]} over {METHODS[line.against]}"),
        Field("ratio", lambda line: significant(line.ratio), "number"),
        Field("95 % limits of agreement", _limits, "number"),
        Field("impacts", lambda line: f"{line.impacts}", "number"),
        Field("left out", lambda line: f"{line.left_out}", "number"),
    )


def _limits(line: Any) -> str:
    return interval(line.low, line.high) if np.isfinite(line.low) else "not known"


def agreement_figure(run: FitRun, quantity: str) -> Markup:
    """Each pair of methods: their ratio over their geometric mean, both on log scales."""
    table = values_of(run, quantity)
    limits = {(row.method, row.against): row for row in lines(agreement({quantity: table}))}
    with style():
        fig, panels = new_figure((10.4, 3.3), 1, 3)
        for axes, (method, against) in zip(panels, combinations(METHODS, 2), strict=True):
            d = log_ratios(table, method, against)
            shown = shown_rows(d.to_frame("d"))["d"]
            ratio = np.exp(shown.to_numpy())
            both = table.loc[shown.index]
            mean = np.sqrt((both[method] * both[against]).to_numpy())
            axes.plot(mean, ratio, "o", ms=3.5, mfc="none", color=POSTERIOR)
            line = limits[(method, against)]
            axes.axhline(1, color=REFERENCE, lw=0.8)
            ends = np.array([line.ratio, line.low, line.high])
            for at, dashes in zip(ends[np.isfinite(ends)], ("-", "--", "--"), strict=False):
                axes.axhline(at, color=MUTED, ls=dashes, lw=1.2)
            axes.set(
                title=f"{METHODS[method]} over\n{METHODS[against]}",
                xlabel=f"geometric mean {quantity} ({UNITS[quantity]})",
                ylabel="ratio",
            )
            for scale, axis, values in (
                (axes.set_xscale, axes.xaxis, [*mean]),
                (axes.set_yscale, axes.yaxis, [*ratio, *ends[np.isfinite(ends)], 1.0]),
            ):
                # Over less a log scale is as good as straight, and its ticks too few.
                if values and max(values) > _MANY_FOLD * min(values):
                    scale("log")
                    log_ticks(axis, values)
        return figure(
            fig,
            f"{quantity} of each impact by two methods: their ratio over their geometric mean, for each pair "
            "of methods, with the mean ratio and its 95 % limits of agreement.",
        )
