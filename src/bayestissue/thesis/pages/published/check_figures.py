"""Figures that hold the model to account: what it predicts."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayestissue.report.page import figure
from bayestissue.report.posterior_figures import NAMES
from bayestissue.report.style import POSTERIOR, PUBLISHED, REFERENCE, new_figure, shown, style
from bayestissue.thesis.pages.published.run import PublishedRun


def inside_share(run: PublishedRun, quantity: str) -> tuple[int, int]:
    """How many published impacts lie inside their 90 % predictive interval, and how many there are."""
    observed = run.observed(f"{quantity}_observed")
    low, high = np.percentile(run.draws(f"{quantity}_observed", "posterior_predictive"), [5, 95], axis=0)
    return int(np.sum((observed >= low) & (observed <= high))), observed.size


def predictive_figure(run: PublishedRun, quantity: str) -> Markup:
    """Published impacts over the predictive interval of their condition, both in % of its median.

    The predictive draws of a condition's impacts are pooled, so a bar is what the model expects of an
    impact on one of its people.
    """
    observed = run.observed(f"{quantity}_observed")
    predicted = run.draws(f"{quantity}_observed", "posterior_predictive")
    of_trial, trials = run.constant("impact_trial"), run.labels("trial")
    present = np.unique(of_trial)
    # One bar per condition: at most a few dozen, each from all of its draws.
    points = np.array(
        [np.percentile(predicted[:, of_trial == trial], [5, 25, 50, 75, 95]) for trial in present]
    )
    low, quarter, _, three_quarters, high = (100 * (points / points[:, 2:3] - 1)).T
    place = np.searchsorted(present, of_trial)
    subject = run.constant("impact_subject")
    offset = 0.5 * (subject / max(subject.max(), 1) - 0.5)
    with style():
        fig, axes = new_figure()
        positions = np.arange(present.size)
        axes.bar(
            positions, high - low, 0.7, low, color=POSTERIOR, alpha=0.2, label="predicted, 90 % of impacts"
        )
        axes.bar(positions, three_quarters - quarter, 0.7, quarter, color=POSTERIOR, alpha=0.35, label="50 %")
        axes.scatter(
            place + offset,
            100 * (observed / points[place, 2] - 1),
            12,
            color=PUBLISHED,
            zorder=3,
            label="published impact",
        )
        axes.axhline(0, color=REFERENCE, ls="--", lw=1)
        axes.set(
            xlabel="condition (the thesis's trial number)",
            ylabel=f"{quantity} off the predicted median (%)",
            xticks=positions,
            xticklabels=[shown(trials[trial]) for trial in present],
        )
        axes.grid(visible=False, axis="x")
        fig.legend(loc="outside upper left", ncols=3)
        return figure(
            fig,
            f"For each condition, the model's 50 % and 90 % predictive intervals of {NAMES[quantity]} "
            "as bars and the published impacts as points.",
        )
