"""Measured traces over what the model predicts, and the residuals' whiteness, drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from bayestissue.report.fit.predictions import STRUCTURED, Residuals
from bayestissue.report.fit.run import FitRun
from bayestissue.report.page import figure
from bayestissue.report.style import (
    MUTED,
    POSTERIOR,
    PUBLISHED,
    REFERENCE,
    label_in_powers,
    new_figure,
    shown,
    style,
)

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
            name, of = run.impacts[index], run.constant("impact_subject")[index]
            title = f"{shown(name)} ({shown(str(of))}, {run.constant('mass_kg')[index]:.3g} kg)"
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
    for place, ax in enumerate(axes.flat):
        (row, second), column = divmod(place // _COLUMNS, 2), place % _COLUMNS
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
    place = np.arange(len(table))
    with style():
        fig, axes = new_figure()
        axes.fill_between(
            place, table["low"], table["high"], step="mid", color=POSTERIOR, alpha=0.3, lw=0,
            label="predicted, 90 %",
        )  # fmt: skip
        axes.plot(place, table["measured"], ".", ms=4, color=PUBLISHED, label="measured")
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
