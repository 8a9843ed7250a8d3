"""Predictive distributions of every cause drawn beside what was observed."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from matplotlib.ticker import LogLocator, NullLocator

from bayestissue.report.page import figure
from bayestissue.report.style import (
    POSTERIOR,
    PUBLISHED,
    REFERENCE,
    label_in_powers,
    log_ticks,
    new_figure,
    shown,
    style,
)
from bayestissue.thesis.causes.statistics import LEVEL, WORDS
from bayestissue.thesis.pages.causes.run import CausesRun


def short(name: str) -> str:
    """A cause's name in the specification as a label."""
    return shown(name.replace("_", " "))


def predictive_figure(run: CausesRun, statistic: str) -> Markup:
    """One statistic: 90 % and 50 % of each cause's campaigns, their median, and the observed value."""
    rows = run.predictive[run.predictive["statistic"] == statistic].set_index("cause")
    names = list(run.causes["cause"])
    rows = rows.loc[names]
    height = np.arange(len(names))[::-1]
    observed = run.value(statistic)
    with style():
        fig, axes = new_figure((4.8, 1.0 + 0.22 * len(names)))
        axes.hlines(height, rows["q05"], rows["q95"], color=POSTERIOR, lw=1.4)
        axes.hlines(height, rows["q25"], rows["q75"], color=POSTERIOR, lw=4.5)
        axes.plot(rows["q50"], height, "|", color="white", ms=6, mew=1.5)
        axes.axvline(observed, color=PUBLISHED, lw=1.6)
        axes.set(yticks=height, yticklabels=[short(name) for name in names], xlabel=WORDS[statistic])
        if statistic == LEVEL:
            axes.set_xscale("log")
            # Decades: there are too many of them for anything between.
            axes.xaxis.set_major_locator(LogLocator(numticks=6))
            axes.xaxis.set_minor_locator(NullLocator())
            label_in_powers(axes.xaxis)
        axes.grid(visible=False, axis="y")
        return figure(
            fig,
            f"{WORDS[statistic]}: for each cause the range of nine tenths and of one half of its campaigns; "
            f"a vertical line at the observed value, {observed:.3g}.",
        )


def probability_figure(run: CausesRun) -> Markup:
    """Posterior probability and joint p-value of every cause, side by side."""
    table = run.causes
    height = np.arange(len(table))[::-1]
    with style():
        fig, (left, right) = new_figure((9.2, 1.0 + 0.24 * len(table)), columns=2, sharey=True)
        left.barh(height, table["probability"], xerr=table["probability_error"], color=POSTERIOR, height=0.6)
        left.set(xlim=(0, 1), xlabel="posterior probability among these causes", yticks=height)
        left.set_yticklabels([short(name) for name in table["cause"]])
        right.plot(table["p_joint"], height, "o", color=POSTERIOR, ms=5)
        right.axvline(0.01, color=REFERENCE, ls="--", lw=1)
        right.set_xscale("log")
        right.set(xlim=(min(table["smallest_p"].min() * 0.6, 0.005), 1.3), xlabel="joint predictive p-value")
        log_ticks(right.xaxis, [0.001, 1.0])
        for axes in (left, right):
            axes.grid(visible=False, axis="y")
        return figure(
            fig,
            "For every cause its posterior probability with its Monte Carlo error, and its joint predictive "
            "p-value on a logarithmic scale with a dashed line at 0.01.",
        )
