"""Figures of the posterior: mass dependence, shrinkage, exponents, and effects of person and condition."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from bayestissue.report.page import figure
from bayestissue.report.posterior_figures import NAMES
from bayestissue.report.style import MUTED, POSTERIOR, PUBLISHED, REFERENCE, new_figure, style
from bayestissue.report.wording import UNITS
from bayestissue.thesis.pages.published.run import PublishedRun

_GRID = 80


def mass_figure(run: PublishedRun, quantity: str, line: tuple[float, float] | None) -> Markup:
    """K (or C) over mass: published estimates, the typical person with its bands, and the thesis's line.

    ``line`` is the thesis's intercept and slope over mass, or None if it printed none.
    """
    mass = run.constant("mass_kg")
    at = mass[run.constant("impact_trial")]
    grid = np.linspace(0.92 * mass.min(), 1.04 * mass.max(), _GRID)
    with style():
        fig, axes = new_figure()
        axes.scatter(
            at, run.observed(f"{quantity}_observed"), 16, color=PUBLISHED, alpha=0.7, label="published impact"
        )
        _lost_conditions(axes, run, quantity)
        if run.has(f"mass_exponent_{quantity}"):
            _typical_band(axes, run, quantity, grid)
        if line is not None:
            axes.plot(grid, line[0] + line[1] * grid, color=REFERENCE, ls="--", lw=1.2, label="thesis's line")
        axes.set(xlabel="mass of the impactor, M (kg)", ylabel=f"{NAMES[quantity]} ({UNITS[quantity]})")
        axes.set_ylim(bottom=0)
        fig.legend(loc="outside upper left", ncols=2)
        return figure(
            fig,
            f"Published {NAMES[quantity]} of every impact over the mass of the impactor, with the posterior "
            "of a typical person as a curve with its 50 % and 90 % bands, and the line the thesis fitted.",
        )


def _lost_conditions(axes: Any, run: PublishedRun, quantity: str) -> None:
    trials = run.labels("trial")
    lost = run.groups["observed_data"].get("averaged_trial", np.array([]))
    if not len(lost):
        return
    at = run.constant("mass_kg")[[trials.index(str(trial)) for trial in np.asarray(lost)]]
    axes.errorbar(
        at,
        run.observed(f"{quantity}_average"),
        run.observed(f"{quantity}_sd"),
        fmt="s",
        ms=5,
        mfc="white",
        color=PUBLISHED,
        lw=1,
        label="mean ± sd, rows lost",
    )


def _typical_band(axes: Any, run: PublishedRun, quantity: str, grid: np.ndarray) -> None:
    log_ratio = np.log(grid / run.reference_mass)
    curve = np.exp(
        run.draws(f"intercept_{quantity}")[:, None]
        + run.draws(f"mass_exponent_{quantity}")[:, None] * log_ratio
    )
    low, quarter, median, three_quarters, high = np.percentile(curve, [5, 25, 50, 75, 95], axis=0)
    axes.fill_between(grid, low, high, color=POSTERIOR, alpha=0.2, lw=0)
    axes.fill_between(grid, quarter, three_quarters, color=POSTERIOR, alpha=0.35, lw=0)
    axes.plot(grid, median, color=POSTERIOR, label="typical person: median, 50 %, 90 %")


def deviations(run: PublishedRun, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Published and posterior K (or C) of each impact over a typical person's in its condition, less one.

    Returns:
        The published deviation [impact] and the posterior's 5 %, 50 % and 95 % points [point, impact].
    """
    typical = np.median(run.draws(f"{quantity}_trial"), axis=0)[run.constant("impact_trial")]
    points = np.percentile(run.draws(quantity), [5, 50, 95], axis=0)
    return run.observed(f"{quantity}_observed") / typical - 1, points / typical - 1


def kept_share(run: PublishedRun, quantity: str) -> float:
    """The slope of posterior on published deviations: 1 is no shrinkage, 0 is all of it."""
    published, points = deviations(run, quantity)
    centred = published - published.mean()
    return float(centred @ points[1] / (centred @ centred))


def shrinkage_figure(run: PublishedRun, quantity: str) -> Markup:
    """Posterior over published deviation from a typical person's in the condition, in %, by impact."""
    published, (low, median, high) = (100 * part for part in deviations(run, quantity))
    with style():
        fig, axes = new_figure()
        axes.errorbar(
            published,
            median,
            [median - low, high - median],
            fmt="o",
            ms=4,
            lw=0.8,
            color=POSTERIOR,
            alpha=0.75,
            label="person in that condition, 90 %",
        )
        ends = np.array([published.min(), published.max()])
        axes.plot(ends, ends, color=REFERENCE, ls="--", lw=1.2, label="taken at its word")
        axes.axhline(0, color=MUTED, lw=0.8)
        axes.set(
            xlabel=f"published {quantity}, off a typical person's in the condition (%)",
            ylabel=f"posterior {quantity}, off the same (%)",
        )
        fig.legend(loc="outside upper left", ncols=2)
        return figure(
            fig,
            f"Posterior deviation of {NAMES[quantity]} from a typical person's in its condition, with 90 % "
            "intervals, over the published deviation of the same impact. Points on the dashed line keep the "
            "published value; points on the level line give it up.",
        )
