"""Figures of the page: the posterior beside what was published, and the thesis's own figures drawn anew."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from bayestissue.dataset.published import PublishedTables
from bayestissue.inference.results.meanings import NAMES, UNITS
from bayestissue.report.page import figure
from bayestissue.report.style import MUTED, POSTERIOR, PUBLISHED, REFERENCE, new_figure, shown
from bayestissue.thesis.pages.published_run import PublishedRun
from bayestissue.thesis.reproduction.conditions import Quantity, conditions
from bayestissue.thesis.reproduction.relations import correlation_figure, printed_line, straight_line


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
    position = np.searchsorted(present, of_trial)
    subject = run.constant("impact_subject")
    offset = 0.5 * (subject / max(subject.max(), 1) - 0.5)
    fig, axes = new_figure()
    positions = np.arange(present.size)
    axes.bar(positions, high - low, 0.7, low, color=POSTERIOR, alpha=0.2, label="predicted, 90 % of impacts")
    axes.bar(positions, three_quarters - quarter, 0.7, quarter, color=POSTERIOR, alpha=0.35, label="50 %")
    axes.scatter(
        position + offset,
        100 * (observed / points[position, 2] - 1),
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


_GRID = 80


def posterior_mass_figure(run: PublishedRun, quantity: str, line: tuple[float, float] | None) -> Markup:
    """K (or C) over mass: published estimates, the typical person with its bands, and the thesis's line.

    ``line`` is the thesis's intercept and slope over mass, or None if it printed none.
    """
    mass = run.constant("mass_kg")
    at = mass[run.constant("impact_trial")]
    grid = np.linspace(0.92 * mass.min(), 1.04 * mass.max(), _GRID)
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


def correlations_plot(published: PublishedTables, quantity: Quantity, *, averages: bool) -> Markup:
    """Figures 5.1 (K) and 5.2 (C) over all impacts, 5.3 (K) and 5.4 (C) over averages: falling |r|."""
    rows = correlation_figure(published, quantity, averages=averages)
    height = np.arange(len(rows))[::-1]
    over = "averages" if averages else "all impacts"
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
    table, rows = conditions(published, quantity), published.estimates
    ends = np.array([0.0, 1.05 * table["mass_kg"].max()])
    refitted, line = straight_line(table).params, printed_line(published, quantity)
    fig, axes = new_figure()
    axes.scatter(rows["mass_kg"], rows[quantity], 12, color=POSTERIOR, alpha=0.5, label="impact")
    for part, filling in (("average", {}), ("rows lost", {"mfc": "white"})):
        shown_rows = table[table["from_rows"] == (part == "average")]
        if len(shown_rows):
            at, average = shown_rows["mass_kg"], shown_rows["average"]
            axes.plot(at, average, "s", ms=5, color=PUBLISHED, label=part, **filling)
    line_through_averages = refitted["const"] + refitted["Mass"] * ends
    axes.plot(ends, line_through_averages, color=POSTERIOR, lw=1.2, label="refitted")
    if line is not None:
        axes.plot(ends, line[0] + line[1] * ends, color=REFERENCE, ls="--", lw=1.2, label="thesis's line")
    axes.set(xlabel="mass of the impactor, M (kg)", ylabel=f"{NAMES[quantity]} ({UNITS[quantity]})")
    fig.legend(loc="outside upper left", ncols=3)
    return figure(
        fig,
        f"{NAMES[quantity]} of every remaining impact and its averages over the mass of the impactor, "
        "with the straight line through the averages and the thesis's own.",
    )
