"""Figures of a fit: estimates of every impact, predicted traces and residuals, people, mass and spreads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.report.fit.estimates import apparent_exponent, shown_rows, side_by_side
from bayestissue.report.fit.groupings import groupings
from bayestissue.report.fit.predictions import STRUCTURED, Residuals
from bayestissue.report.fit.run import FitRun
from bayestissue.report.page import figure
from bayestissue.report.posterior import QUANTITIES, Quantity, group_words, typical_draws
from bayestissue.report.posterior_figures import NAMES, draw_intervals, ranked
from bayestissue.report.style import (
    MUTED,
    PALETTE,
    POSTERIOR,
    PUBLISHED,
    REFERENCE,
    label_in_powers,
    log_ticks,
    new_figure,
    shown,
    style,
)
from bayestissue.report.wording import UNITS

# In percent off the posterior: nothing positive lies lower than -100.
_BELOW_ZERO = -105.0
_EXACT, _DDS = PALETTE[1], PALETTE[3]


def estimates_figure(run: FitRun, quantity: str) -> Markup:
    """Impacts in the order of their posterior median: the values, and how far each is off the posterior.

    Above, on a log scale, both methods' estimates; below, in percent of the posterior median, its 50 % and
    90 % intervals with what lies near them.
    """
    estimates = side_by_side(run, quantity)
    table = shown_rows(estimates.sort_values("median", kind="stable"))
    position = np.arange(len(table))
    with style():
        fig, (above, below) = new_figure((9.6, 5.6), 2, 1, sharex=True)
        above.semilogy(
            position, table["median"], "o", ms=3, color=POSTERIOR, zorder=4, label="posterior median"
        )
        above.semilogy(position, table["exact"], "^", ms=3.6, color=_EXACT, zorder=3, label="exact estimate")
        above.semilogy(
            position, table["dds"], "D", ms=3.2, mfc="none", color=_DDS, label="thesis's method (dds)"
        )
        above.set(ylabel=f"{quantity} ({UNITS[quantity]})")
        log_ticks(above.yaxis, table[["median", "exact", "dds"]].to_numpy().ravel())
        off_scale = _deviations(below, table, position)
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
        whose = (
            "every impact" if len(table) == len(estimates) else f"{len(table)} of {len(estimates)} impacts"
        )
        return figure(
            fig,
            f"{NAMES[quantity]} of {whose} by posterior, by both point estimates and, where known, the "
            f"truth: values above, deviations from the posterior median below.{note}",
            raster=True,
        )


def _deviations(axes: Any, table: pd.DataFrame, position: np.ndarray) -> int:
    """Draw the lower panel; how many point estimates lie off its scale."""
    off = 100 * (table.div(table["median"], axis=0) - 1)
    axes.vlines(position, off["eti90_low"], off["eti90_high"], color=POSTERIOR, lw=1, label="90 %")
    axes.vlines(position, off["eti50_low"], off["eti50_high"], color=POSTERIOR, lw=2.6, label="50 %")
    axes.plot(position, off["exact"], "^", ms=3.6, color=_EXACT)
    axes.plot(position, off["dds"], "D", ms=3.2, mfc="none", color=_DDS)
    if off["truth"].notna().any():
        axes.plot(position, off["truth"], "x", ms=4, mew=1.2, color=REFERENCE, label="truth")
    near = np.nanpercentile(off[["eti90_low", "eti90_high", "truth"]].abs(), 99)
    limit = 1.6 * max(near, 1e-3)
    axes.axhline(0, color=POSTERIOR, lw=0.6)
    lowest = max(-limit, _BELOW_ZERO)
    axes.set_ylim(lowest, limit)
    return int(((off[["exact", "dds"]] > limit) | (off[["exact", "dds"]] < lowest)).sum().sum())


_COLUMNS = 3
_SCALES = {"deceleration": ("m/s²", 1.0), "displacement": ("mm", 1e3)}


def traces_figure(run: FitRun, which: list[int]) -> Markup:
    """For each of ``which``: the measured trace over its predictive band, and under it the rest.

    They are numbers among the impacts that have predictions.
    """
    rows = -(-len(which) // _COLUMNS)
    unit, scale = _SCALES[run.shown]
    replicates = scale * run.draws(run.shown, "posterior_predictive")[:, which]
    bands = np.percentile(replicates, [5, 25, 50, 75, 95], axis=0)
    measured = scale * run.groups["observed_data"][run.shown].to_numpy()[which]
    rows_of_run = run.predicted[which]
    time = 1e3 * run.constant("time")[rows_of_run]
    with style():
        fig, axes = _panels(rows)
        for at, index in enumerate(rows_of_run):
            row, column = divmod(at, _COLUMNS)
            above, below = axes[2 * row, column], axes[2 * row + 1, column]
            _panel(above, below, time[at], measured[at], bands[:, at])
            name, subject = run.impacts[index], run.constant("impact_subject")[index]
            title = f"{shown(name)} ({shown(str(subject))}, {run.constant('mass_kg')[index]:.3g} kg)"
            above.set_title(title, fontsize=8)
            below.set_xlabel("time since contact (ms)" if row == rows - 1 else "", fontsize=8)
            if column == 0:
                above.set_ylabel(f"{run.shown}\n({unit})", fontsize=8)
                below.set_ylabel(f"residual\n({unit})", fontsize=8)
        for ax in axes[:, :].reshape(rows, 2, _COLUMNS).transpose(0, 2, 1).reshape(-1, 2)[len(which) :].flat:
            ax.remove()
        handles, labels = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="upper left", ncols=4)
        return figure(
            fig,
            f"Measured {run.shown} of {len(which)} impacts over the model's 50 % and 90 % predictive bands, "
            "with the measured values less the predictive median in a panel under each.",
            raster=True,
        )


def _panels(rows: int) -> tuple[Figure, Any]:
    """Pairs of axes, one above the other, at places that need not be found by drawing everything twice."""
    width, height = 9.6, 0.7 + 2.3 * rows
    fig, axes = new_figure((width, height), 2 * rows, _COLUMNS, squeeze=False)
    fig.set_layout_engine("none")
    left, right, top, bottom = 0.75, 0.12, 0.3, 0.45
    between, gap = 0.5, 0.48
    wide = (width - left - right - (_COLUMNS - 1) * between) / _COLUMNS
    pair = (height - top - bottom) / rows
    inside = 0.06
    tall = (pair - gap - inside) / 3
    for panel, ax in enumerate(axes.flat):
        (row, second), column = divmod(panel // _COLUMNS, 2), panel % _COLUMNS
        foot = bottom + (rows - 1 - row) * pair + (0 if second else tall + inside)
        size = (wide / width, (tall if second else 2 * tall) / height)
        ax.set_position(((left + column * (wide + between)) / width, foot / height, *size))
    fig.align_ylabels(axes[:, 0])
    return fig, axes


def _panel(above: Any, below: Any, time: np.ndarray, measured: np.ndarray, bands: np.ndarray) -> None:
    known = np.isfinite(time) & np.isfinite(bands[2]) & np.isfinite(measured)
    time, measured, bands = time[known], measured[known], bands[:, known]
    for axes, middle in ((above, 0 * bands[2]), (below, bands[2])):
        low, quarter, _, three_quarters, high = bands - middle
        axes.plot(time, measured - middle, ".", ms=1.8, color=PUBLISHED, label="measured", zorder=3)
        axes.fill_between(time, low, high, color=POSTERIOR, alpha=0.25, lw=0, label="predicted, 90 %")
        axes.fill_between(time, quarter, three_quarters, color=POSTERIOR, alpha=0.4, lw=0, label="50 %")
        axes.tick_params(labelsize=7)
    above.plot(time, bands[2], color=POSTERIOR, lw=1, label="predicted median")
    above.set_xticklabels([])
    below.axhline(0, color=MUTED, lw=0.6)


def lag_one_figure(left: Residuals) -> Markup:
    """Lag-1 autocorrelation of every impact's residuals over that of data made by the model."""
    table = left.lag_one.sort_values("measured", kind="stable")
    position = np.arange(len(table))
    with style():
        fig, axes = new_figure()
        axes.fill_between(
            position, table["low"], table["high"], step="mid", color=POSTERIOR, alpha=0.3, lw=0,
            label="predicted, 90 %",
        )  # fmt: skip
        axes.plot(position, table["measured"], ".", ms=4, color=PUBLISHED, label="measured")
        axes.axhline(0, color=REFERENCE, ls="--", lw=1, label="white")
        axes.set(xlabel="impacts, in order", ylabel="autocorrelation of residuals at lag 1")
        fig.legend(loc="outside upper left", ncols=3)
        return figure(
            fig,
            "Autocorrelation at lag one of each impact's residuals, as points, over the 90 % range of data "
            "made by the model.",
            raster=len(table) > 300,
        )


def whiteness_figure(whole: np.ndarray, one_step: np.ndarray) -> Markup:
    """Sorted p-values over what the model would give, both on log scales.

    Args:
        whole: of each impact's residuals being the model's noise.
        one_step: of Ljung and Box, of the exact ARMA(2,1) fits.
    """
    with style():
        fig, axes = new_figure()
        sets = (
            (whole, "o", POSTERIOR, "what the fit leaves"),
            (one_step, "^", PUBLISHED, "one step ahead, exact ARMA(2,1)"),
        )
        least = 1e-12
        for values, mark, colour, label in sets:
            p = np.sort(np.maximum(values[np.isfinite(values)], least))
            if p.size:
                axes.loglog(
                    (np.arange(p.size) + 0.5) / p.size, p, mark, ms=3.4, color=colour, mfc="none", label=label
                )
        ends = np.array([1e-3, 1])
        axes.loglog(ends, ends, color=REFERENCE, ls="--", lw=1, label="the model's noise")
        axes.axhline(STRUCTURED, color=MUTED, lw=0.8)
        for axis in (axes.xaxis, axes.yaxis):
            label_in_powers(axis)
        axes.set(xlabel="p expected", ylabel="p found (10 lags)")
        fig.legend(loc="outside upper left", ncols=2)
        return figure(
            fig,
            "Sorted p-values of the test of every impact's residuals over those that the model's noise "
            "would give. Points far below the dashed line are residuals with structure.",
        )


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
