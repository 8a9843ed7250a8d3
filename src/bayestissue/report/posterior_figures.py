"""Figures of a posterior, whatever data it came from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from bayestissue.inference.results.meanings import SECANTS
from bayestissue.report.page import figure
from bayestissue.report.posterior import PosteriorRun
from bayestissue.report.style import MUTED, POSTERIOR, REFERENCE, new_figure, shown, style

_MOST_ROWS = 60
NAMES = {"K": "stiffness K", "C": "damping C"}


def exponent_figure(run: PosteriorRun, quantity: str) -> Markup:
    """The posterior of a mass exponent, with the regions that count as 0 and as 1 in practice."""
    draws, name = run.draws(f"mass_exponent_{quantity}"), SECANTS.get(quantity, quantity)
    rows = run.hypotheses.loc[
        (run.hypotheses["quantity"] == quantity) & run.hypotheses["value"].notna(), ["rope_low", "rope_high"]
    ]
    with style():
        fig, axes = new_figure((4.8, 2.7))
        for low, high in rows.to_numpy():
            axes.axvspan(low, high, color=MUTED, alpha=0.25, lw=0)
        bins = min(60, max(15, int(np.sqrt(draws.size))))
        axes.hist(draws, bins=bins, density=True, color=POSTERIOR, alpha=0.85)
        for value in (0, 1):
            axes.axvline(value, color=REFERENCE, ls="--", lw=1.2)
        axes.set(
            xlabel=f"mass exponent of {name} (no unit)",
            yticks=[],
            xlim=(min(-0.25, draws.min() - 0.05), max(1.25, draws.max() + 0.05)),
        )
        axes.spines["left"].set_visible(False)
        return figure(
            fig,
            f"Histogram of the posterior draws of the mass exponent of {name}; dashed lines at 0, which "
            "is a fixed value, and at 1, which is proportion to mass; grey bands mark what counts as equal "
            "to them.",
        )


def draw_intervals(
    axes: Any,
    height: np.ndarray,
    drawn: np.ndarray,
    colour: str = POSTERIOR,
    mark: str = "o",
    label: str = "",
) -> None:
    """Median, 50 % and 90 % interval of ``drawn`` [draw, row], each row at its ``height``."""
    low, quarter, median, three_quarters, high = np.percentile(drawn, [5, 25, 50, 75, 95], axis=0)
    axes.hlines(height, low, high, color=colour, lw=1.2)
    axes.hlines(height, quarter, three_quarters, color=colour, lw=3.6)
    axes.plot(median, height, mark, ms=5, mfc="white", color=colour, label=label)
    axes.grid(visible=False, axis="y")


def ranked(drawn: np.ndarray, names: Sequence[str], **labels: str) -> tuple[Figure, Any]:
    """`draw_intervals` with the greatest on top; of more than 60 the 30 greatest and the 30 least."""
    order = np.argsort(np.median(drawn, axis=0), kind="stable")
    if order.size > _MOST_ROWS:
        order = np.r_[order[: _MOST_ROWS // 2], order[-_MOST_ROWS // 2 :]]
    height = np.arange(order.size)
    fig, axes = new_figure((4.8, 0.8 + 0.24 * order.size))
    draw_intervals(axes, height, drawn[:, order])
    ticks = [shown(names[index]) for index in order]
    axes.set(yticks=height, yticklabels=ticks, ylim=(-0.6, order.size - 0.4), **labels)
    return fig, axes


def effects_figure(run: PosteriorRun, quantity: str, level: str) -> Markup:
    """Each person's (``level`` "subject") or condition's ("trial") effect on K or C, in % of the typical."""
    effects = 100 * np.expm1(run.draws(f"{level}_effect_{quantity}"))
    labels, kind = run.labels(level), {"subject": "person", "trial": "condition"}[level]
    height = np.arange(len(labels))[::-1]
    with style():
        fig, axes = new_figure((4.8, 0.8 + 0.24 * len(labels)))
        draw_intervals(axes, height, effects)
        axes.axvline(0, color=REFERENCE, ls="--", lw=1)
        axes.set(
            xlabel=f"{quantity} off the typical {kind} (%)",
            yticks=height,
            yticklabels=[shown(label) for label in labels],
            ylabel=kind,
        )
        return figure(
            fig,
            f"Effect of each {kind} on {NAMES[quantity]} in percent of the typical {kind}: "
            "posterior median, 50 % and 90 % interval.",
        )
