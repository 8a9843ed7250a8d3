"""Posterior, point estimates and truth of every impact, drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.report.fit.estimates import shown_rows, side_by_side
from bayestissue.report.fit.run import FitRun
from bayestissue.report.page import figure
from bayestissue.report.posterior_figures import NAMES
from bayestissue.report.style import PALETTE, POSTERIOR, REFERENCE, log_ticks, new_figure, style
from bayestissue.report.wording import UNITS

# In percent off the posterior: nothing positive lies lower than -100.
_BELOW_ZERO = -105.0
_EXACT, _DDS = PALETTE[1], PALETTE[3]


def estimates_figure(run: FitRun, quantity: str) -> Markup:
    """Impacts in the order of their posterior median: the values, and how far each is off the posterior.

    Above, on a log scale, both methods' estimates; below, in percent of the posterior median, its 50 % and
    90 % intervals with what lies near them.
    """
    every = side_by_side(run, quantity)
    table = shown_rows(every.sort_values("median", kind="stable"))
    place = np.arange(len(table))
    with style():
        fig, (above, below) = new_figure((9.6, 5.6), 2, 1, sharex=True)
        above.semilogy(place, table["median"], "o", ms=3, color=POSTERIOR, zorder=4, label="posterior median")
        above.semilogy(place, table["exact"], "^", ms=3.6, color=_EXACT, zorder=3, label="exact estimate")
        above.semilogy(
            place, table["dds"], "D", ms=3.2, mfc="none", color=_DDS, label="thesis's method (dds)"
        )
        above.set(ylabel=f"{quantity} ({UNITS[quantity]})")
        log_ticks(above.yaxis, table[["median", "exact", "dds"]].to_numpy().ravel())
        off_scale = _deviations(below, table, place)
        below.set(
            xlabel=f"impacts, in the order of their posterior {quantity}",
            ylabel=f"off the posterior\nmedian of {quantity} (%)",
            xlim=(-1, len(table)),
        )
        marks = [
            pair for axes in (above, below) for pair in zip(*axes.get_legend_handles_labels(), strict=True)
        ]
        fig.legend(*zip(*marks, strict=True), loc="outside upper left", ncols=len(marks))
        note = f" {off_scale} estimates lie off the lower scale." if off_scale else ""
        whose = "every impact" if len(table) == len(every) else f"{len(table)} of {len(every)} impacts"
        return figure(
            fig,
            f"{NAMES[quantity]} of {whose} by posterior, by both point estimates and, where known, the "
            f"truth: values above, deviations from the posterior median below.{note}",
            raster=True,
        )


def _deviations(axes: Any, table: pd.DataFrame, place: np.ndarray) -> int:
    """Draw the lower panel; how many point estimates lie off its scale."""
    off = 100 * (table.div(table["median"], axis=0) - 1)
    axes.vlines(place, off["eti90_low"], off["eti90_high"], color=POSTERIOR, lw=1, label="90 %")
    axes.vlines(place, off["eti50_low"], off["eti50_high"], color=POSTERIOR, lw=2.6, label="50 %")
    axes.plot(place, off["exact"], "^", ms=3.6, color=_EXACT)
    axes.plot(place, off["dds"], "D", ms=3.2, mfc="none", color=_DDS)
    if off["truth"].notna().any():
        axes.plot(place, off["truth"], "x", ms=4, mew=1.2, color=REFERENCE, label="truth")
    near = np.nanpercentile(off[["eti90_low", "eti90_high", "truth"]].abs(), 99)
    limit = 1.6 * max(near, 1e-3)
    axes.axhline(0, color=POSTERIOR, lw=0.6)
    lowest = max(-limit, _BELOW_ZERO)
    axes.set_ylim(lowest, limit)
    return int(((off[["exact", "dds"]] > limit) | (off[["exact", "dds"]] < lowest)).sum().sum())
