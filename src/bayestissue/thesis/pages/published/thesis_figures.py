"""Figures 5.1 to 5.6 of the thesis, drawn anew from its tables as they are."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayestissue.dataset.published import PublishedTables
from bayestissue.report.page import figure
from bayestissue.report.posterior_figures import NAMES
from bayestissue.report.style import POSTERIOR, PUBLISHED, REFERENCE, new_figure, style
from bayestissue.report.wording import UNITS
from bayestissue.thesis.reproduction import correlation_figure, mass_figure
from bayestissue.thesis.reproduction.conditions import Quantity


def correlations_plot(published: PublishedTables, quantity: Quantity, *, averages: bool) -> Markup:
    """Figures 5.1 (K) and 5.2 (C) over all impacts, 5.3 (K) and 5.4 (C) over averages: falling |r|."""
    rows = correlation_figure(published, quantity, averages=averages)
    height = np.arange(len(rows))[::-1]
    over = "averages" if averages else "all impacts"
    with style():
        fig, axes = new_figure((4.8, 0.9 + 0.24 * len(rows)))
        axes.barh(height, rows["correlation"].abs(), 0.65, color=POSTERIOR, alpha=0.55, label="recomputed")
        axes.plot(rows["published"].abs(), height, "D", ms=4.5, color=PUBLISHED, label="printed")
        axes.set(
            title=f"{NAMES[quantity]}, {over}",
            xlabel="absolute correlation (no unit)",
            xlim=(0, 1.03),
            yticks=height,
            yticklabels=rows["variable"].to_list(),
        )
        axes.grid(visible=False, axis="y")
        fig.legend(loc="outside lower right", ncols=2)
        return figure(
            fig,
            f"Absolute correlations of {NAMES[quantity]} with each variable over {over}, largest first: bars "
            "recomputed, diamonds as printed.",
        )


def mass_plot(published: PublishedTables, quantity: Quantity) -> Markup:
    """Figures 5.5 (K) and 5.6 (C): every remaining impact and the averages, over the mass."""
    shown = mass_figure(published, quantity)
    ends = np.array([0.0, 1.05 * shown.averages["mass_kg"].max()])
    kept, lost = shown.averages[shown.averages["from_rows"]], shown.averages[~shown.averages["from_rows"]]
    with style():
        fig, axes = new_figure()
        axes.scatter(
            shown.impacts["mass_kg"], shown.impacts["value"], 12, color=POSTERIOR, alpha=0.5, label="impact"
        )
        axes.plot(kept["mass_kg"], kept["average"], "s", ms=5, color=PUBLISHED, label="average")
        if len(lost):
            axes.plot(
                lost["mass_kg"], lost["average"], "s", ms=5, mfc="white", color=PUBLISHED, label="rows lost"
            )
        axes.plot(ends, shown.constant + shown.slope * ends, color=POSTERIOR, lw=1.2, label="refitted")
        axes.plot(
            ends,
            shown.printed_constant + shown.printed_slope * ends,
            color=REFERENCE,
            ls="--",
            lw=1.2,
            label="thesis's line",
        )
        axes.set(xlabel="mass of the impactor, M (kg)", ylabel=f"{NAMES[quantity]} ({UNITS[quantity]})")
        fig.legend(loc="outside upper left", ncols=3)
        return figure(
            fig,
            f"{NAMES[quantity]} of every remaining impact and its averages over the mass of the impactor, "
            "with the straight line through the averages and the thesis's own.",
        )
