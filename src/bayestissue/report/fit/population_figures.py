"""People, conditions, mass and the spreads between them, drawn."""

from __future__ import annotations

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.report.fit.estimates import apparent_exponent, shown_rows, side_by_side
from bayestissue.report.fit.groupings import groupings
from bayestissue.report.fit.run import FitRun
from bayestissue.report.page import figure
from bayestissue.report.posterior import QUANTITIES, Quantity, typical_draws
from bayestissue.report.posterior_figures import NAMES, draw_intervals, ranked
from bayestissue.report.remarks import group_words
from bayestissue.report.style import (
    MUTED,
    PALETTE,
    POSTERIOR,
    PUBLISHED,
    REFERENCE,
    log_ticks,
    new_figure,
    style,
)
from bayestissue.report.wording import UNITS

_GRID = 60


def ranked_figure(run: FitRun, quantity: str, level: str) -> Markup:
    """K (or C, or another) of every person (``level`` "subject"), condition ("trial") and so on, ranked."""
    variable, (one, _) = f"{quantity}_{stem_of(level)}", group_words(level)
    drawn, name = run.draws(variable), NAMES.get(quantity, quantity)
    unit = UNITS.get(quantity) or run.groups["posterior"][variable].attrs["unit"]
    names = _with_ranks(run.labels(level), drawn)
    with style():
        fig, _ = ranked(drawn, names, xlabel=f"{name} ({unit})", ylabel=one)
        return figure(
            fig,
            f"{name} of each {one}, ranked: posterior median, 50 % and 90 % interval, "
            "and in brackets the 90 % interval of the rank.",
        )


def _with_ranks(names: list[str], drawn: np.ndarray) -> list[str]:
    """Each name with the 90 % interval of its rank, 1 for the greatest; ``drawn`` is [draw, name]."""
    ranks = 1 + np.argsort(np.argsort(-drawn, axis=1), axis=1)
    low, high = np.percentile(ranks, [5, 95], axis=0).round().astype(int)
    return [
        f"{name} ({a})" if a == b else f"{name} ({a} to {b})"
        for name, a, b in zip(names, low, high, strict=True)
    ]


def mass_figure(run: FitRun, quantity: Quantity) -> Markup:
    """K (or C) over mass on log scales: impacts, conditions, the posterior line, exponents 0 and 1."""
    mass = run.constant("mass_kg")
    grid = np.geomspace(0.93 * mass.min(), 1.07 * mass.max(), _GRID)
    ratio = np.log(grid / run.reference_mass)
    table = shown_rows(side_by_side(run, quantity).assign(mass=mass))
    apparent = apparent_exponent(run, quantity)
    who = "this person" if run.people == 1 else "typical person"
    typical = typical_draws(run, quantity)
    level = float(np.median(typical))
    with style():
        fig, axes = new_figure((4.8, 4.2))
        axes.plot(
            table["mass"], table["dds"], "D", ms=3, mfc="none", mew=0.7, color=PUBLISHED,
            label="thesis's method (dds)",
        )  # fmt: skip
        if apparent:
            line = np.exp(apparent.intercept + apparent.slope.median * ratio)
            axes.plot(grid, line, color=PUBLISHED, lw=1.2)
        axes.plot(table["mass"], table["median"], ".", ms=3.5, color=MUTED, label="impact, posterior median")
        at, drawn = _conditions(run, quantity)
        low, median, high = np.percentile(drawn, [5, 50, 95], axis=0)
        axes.errorbar(
            at, median, [median - low, high - median], fmt="s", ms=4.5, mfc="white", lw=1.2, color=POSTERIOR,
            label=f"condition, {who}, 90 %",
        )  # fmt: skip
        if run.has(f"mass_exponent_{quantity}"):
            slope = run.draws(f"mass_exponent_{quantity}")[:, None] * ratio
            curve = typical[:, None] * np.exp(slope)
            low, middle, high = np.percentile(curve, [5, 50, 95], axis=0)
            axes.fill_between(grid, low, high, color=POSTERIOR, alpha=0.2, lw=0)
            axes.plot(grid, middle, color=POSTERIOR, label=f"{who}, 90 % band")
        axes.plot(grid, level + 0 * grid, color=REFERENCE, ls="--", lw=1, label="exponent 0")
        axes.plot(
            grid, level * grid / run.reference_mass, color=REFERENCE, ls=":", lw=1.2, label="exponent 1"
        )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="mass of the impactor, M (kg)",
            ylabel=f"{NAMES[quantity]} ({UNITS[quantity]})",
        )
        log_ticks(axes.xaxis, mass)
        log_ticks(axes.yaxis, table[["median", "dds"]].to_numpy().ravel())
        fig.legend(loc="outside upper left", ncols=2, fontsize=7.5)
        return figure(
            fig,
            f"{NAMES[quantity]} over the mass of the impactor on log scales: posterior of conditions and "
            "impacts with the fitted line, the thesis's point estimates, and lines for exponents 0 and 1.",
        )


def _conditions(run: FitRun, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Geometric mean mass of each condition, and draws of a typical person's K or C in it, [draw, trial]."""
    frame = pd.DataFrame(
        {"trial": run.constant("impact_trial").astype(str), "log_mass": np.log(run.constant("mass_kg"))}
    )
    mass = np.exp(frame.groupby("trial")["log_mass"].mean()).reindex(run.labels("trial"))
    return mass.to_numpy(), run.draws(f"{quantity}_trial")


def spreads_figure(run: FitRun) -> Markup:
    """The population's standard deviations of log K and log C, in percent, with 50 % and 90 % intervals."""
    levels = dict.fromkeys(("subject", "trial", *groupings(run), "impact"))
    names = [
        level
        for level in levels
        if any(run.has(f"sd_{stem_of(level)}_{quantity}") for quantity in QUANTITIES)
    ]
    with style():
        fig, axes = new_figure((4.8, 1.1 + 0.55 * len(names)))
        for shift, colour, mark, quantity in zip((0.14, -0.14), PALETTE, "os", QUANTITIES, strict=False):
            present = [level for level in names if run.has(f"sd_{stem_of(level)}_{quantity}")]
            height = np.array([len(names) - 1 - names.index(level) for level in present]) + shift
            drawn = 100 * np.expm1(
                np.stack([run.draws(f"sd_{stem_of(level)}_{quantity}") for level in present], axis=1)
            )
            draw_intervals(axes, height, drawn, colour, mark, NAMES[quantity])
        axes.set(
            xlabel="standard deviation (% of K or C)",
            yticks=np.arange(len(names))[::-1],
            yticklabels=["impacts" if name == "impact" else group_words(name)[1] for name in names],
            ylim=(-0.6, len(names) - 0.4),
            xlim=(0, None),
        )
        fig.legend(loc="outside upper left", ncols=2)
        return figure(
            fig,
            "Posterior of the standard deviations of K and C between people, conditions, other groups and "
            "impacts, in percent: median, 50 % and 90 % interval.",
        )
