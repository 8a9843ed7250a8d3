"""Runs beside each other, drawn: how well they predict, and what they estimate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes

from bayestissue.inference.results.meanings import heading_words
from bayestissue.report.page import figure
from bayestissue.report.posterior_figures import NAMES
from bayestissue.report.style import MUTED, PALETTE, POSTERIOR, REFERENCE, log_ticks, new_figure, shown, style
from bayestissue.report.wording import UNITS

_MARKS = "osD^vP*"
MOST_PEOPLE = 30
_COMPARABLE = {
    "K": ("K_secant_of_impacts", "K_secant_of_subject"),
    "C": ("C_equivalent_of_impacts", "C_equivalent_of_subject"),
}


def comparison_figure(table: pd.DataFrame, scheme: str) -> Markup:
    """Differences of expected log predictive density from the best model, with one standard error."""
    rows = table[table["scheme"] == scheme].sort_values("elpd", ascending=False)
    height = np.arange(len(rows))[::-1]
    with style():
        fig, axes = new_figure((4.8, 0.9 + 0.28 * len(rows)))
        axes.errorbar(
            rows["elpd_difference"],
            height,
            xerr=rows["se_difference"],
            fmt="o",
            ms=5,
            lw=1.4,
            color=POSTERIOR,
        )
        axes.axvline(0, color=REFERENCE, ls="--", lw=1)
        axes.set(
            title=scheme,
            xlabel="expected log predictive density off the best (nats)",
            yticks=height,
            yticklabels=[shown(name) for name in rows["model"]],
        )
        axes.grid(visible=False, axis="y")
        return figure(
            fig,
            f"Difference in expected log predictive density from the best model, {scheme}, "
            "one point with its standard error per model; further left predicts worse.",
        )


def side_by_side_figure(
    posteriors: pd.DataFrame, runs: Sequence[str], quantity: str, *, same_element: bool = True
) -> Markup:
    """The mass exponent, K (or C) of a typical, a new and each person: a colour and a mark a run.

    Unless the runs are of the ``same_element``, what means the same in all stands for K (or C): the
    secant stiffness (the equivalent damping) of the recorded impacts, and of each person's own.
    """
    parts = _parts(posteriors, quantity, same_element)
    heights = [1.1 + 0.16 * len(runs) * rows["label"].nunique() for _, rows in parts]
    with style():
        fig, panels = new_figure((4.8, sum(heights)), rows=len(parts), squeeze=False, height_ratios=heights)
        for axes, (variable, rows) in zip(panels[:, 0], parts, strict=True):
            _draw(axes, rows, runs)
            exponent = variable.startswith("mass_exponent")
            for value in (0, 1) if exponent else ():
                axes.axvline(value, color=MUTED, ls="--", lw=1)
            if not exponent:
                axes.set_xscale("log")
                log_ticks(axes.xaxis, rows[["eti90_low", "eti90_high"]].to_numpy().ravel())
            unit = "no unit" if exponent else UNITS[quantity]
            axes.set_xlabel(f"{heading_words(variable, rows['of'].iloc[0])} ({unit})")
        handles, labels = panels[-1, 0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside upper left", ncols=3)
        return figure(
            fig,
            f"{NAMES[quantity]} by run: "
            f"{'; '.join(heading_words(variable, rows['of'].iloc[0]) for variable, rows in parts)}; "
            "posterior median and 90 % interval, a colour and a mark for each run.",
        )


def _parts(posteriors: pd.DataFrame, quantity: str, same_element: bool) -> list[tuple[str, pd.DataFrame]]:
    parts = []
    values = tuple(f"{quantity}_{part}" for part in ("typical_person", "new", "subject"))
    values = values if same_element else _COMPARABLE[quantity]
    for variable in (f"mass_exponent_{quantity}", f"mass_exponent_{quantity}_common_depth", *values):
        rows = posteriors[posteriors["variable"] == variable]
        rows = rows[rows["label"].isin(rows["label"].drop_duplicates()[:MOST_PEOPLE])]
        if len(rows):
            parts.append((variable, rows))
    return parts


def _draw(axes: Axes, rows: pd.DataFrame, runs: Sequence[str]) -> None:
    labels = list(rows["label"].drop_duplicates())
    for k, run in enumerate(runs):
        chosen = rows[rows["run"] == run]
        height = -np.array([labels.index(label) for label in chosen["label"]]) - k * 0.7 / len(runs)
        colour = PALETTE[k % len(PALETTE)]
        axes.hlines(height, chosen["eti90_low"], chosen["eti90_high"], color=colour, lw=1.4)
        mark = _MARKS[k % len(_MARKS)]
        axes.plot(chosen["median"], height, mark, ms=4, mfc="white", color=colour, label=shown(run))
    middle = -np.arange(len(labels)) - 0.35 * (len(runs) - 1) / len(runs)
    names = [shown(label) or "all" if len(labels) > 1 else "" for label in labels]
    axes.set(yticks=middle, yticklabels=names)
    axes.set_ylim(-len(labels) + 0.1, 0.4)
    axes.grid(visible=False, axis="y")
    if labels == [""]:
        axes.set(yticks=[])
