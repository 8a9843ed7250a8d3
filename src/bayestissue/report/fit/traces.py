"""What the model predicts of each trace, and what the measured trace leaves over."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from markupsafe import Markup
from matplotlib.figure import Figure
from scipy.special import chdtrc

from bayestissue.inference.points.whiteness import autocorrelation
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
)
from bayestissue.report.wording import listed, percent

PANELS = 9
STRUCTURED = 0.01
OTHER_NOISE = 0.01
_MOST_TESTED = 250


@dataclass(frozen=True)
class Residuals:
    """Measured traces, and replicates of them, less the median of the replicates, NaN past a row's end.

    Attributes:
        measured: [impact, sample], in m/s² (or m where displacement was recorded).
        replicated: [draw, impact, sample].
        which: the rows of the run's impacts that they belong to.
    """

    measured: Float[np.ndarray, "impact sample"]
    replicated: Float[np.ndarray, "draw impact sample"]
    which: np.ndarray

    @cached_property
    def used(self) -> Bool[np.ndarray, "impact sample"]:
        """Where both are known."""
        return np.isfinite(self.measured) & np.isfinite(self.replicated[0])

    @cached_property
    def _lag_one(self) -> tuple[Float[np.ndarray, "draw impact"], Float[np.ndarray, " impact"]]:
        """Lag-1 autocorrelations of the replicates and of what was measured, as of `lag_one`."""
        replicated, measured = (
            autocorrelation(traces, self.used, powers=4, lags=1)
            for traces in (self.replicated, self.measured)
        )
        return replicated, measured

    @cached_property
    def lag_one(self) -> pd.DataFrame:
        """Lag-1 autocorrelation once a cubic in time is taken off, one row an impact.

        Errors of the measuring chain are as smooth as a cubic and other in every recording; what is left
        is noise.

        ``measured``, the replicates' 5 % and 95 % points ``low`` and ``high``, and whether it is ``inside``.
        """
        replicated, measured = self._lag_one
        low, high = np.percentile(replicated, [5, 95], axis=0)
        inside = (low <= measured) & (measured <= high)
        return pd.DataFrame({"measured": measured, "low": low, "high": high, "inside": inside})

    @cached_property
    def other_noise_p(self) -> float:
        """The p-value of the recorded noise being the model's, by the ranks of ``lag_one`` over all impacts.

        The rank of a measured value among its replicates is uniform where the model made both. Doubled to
        the nearer end it is each impact's p-value, and -2 times the sum of their logs is chi-squared with
        twice as many degrees of freedom as there are impacts (Fisher), whatever their number. The replicates
        come from draws that have seen the measured trace, which draws the ranks to the middle: chance raises
        the alarm no more often than stated.
        """
        replicated, measured = self._lag_one
        draws = len(replicated)
        above = (replicated > measured).sum(axis=0)
        nearer = np.minimum(above, draws - above)
        p = np.minimum(2 * (nearer + 1) / (draws + 1), 1.0)[np.isfinite(measured)]
        return float(chdtrc(2 * p.size, -2 * np.log(p).sum())) if p.size else 1.0


def residuals(run: FitRun) -> Residuals:
    """The residuals of every impact, or of 250 evenly spaced ones if there are more."""
    count = len(run.predicted)
    which = np.unique(np.linspace(0, count - 1, min(count, _MOST_TESTED)).round().astype(int))
    replicates = run.draws(run.shown, "posterior_predictive")[:, which].astype(float)
    middle = np.median(replicates, axis=0)
    measured = run.groups["observed_data"][run.shown].to_numpy()[which]
    return Residuals(measured - middle, replicates - middle, run.predicted[which])


def inside_band(left: Residuals) -> float:
    """The share of all measured samples inside the replicates' 90 % band."""
    low, high = np.percentile(left.replicated, [5, 95], axis=0)
    inside = (left.measured >= low) & (left.measured <= high)
    return float(inside[left.used].mean())


def chosen_impacts(run: FitRun) -> list[int]:
    """Nine impacts at even steps of rank from the softest to the stiffest, by posterior median of K.

    Numbers among those that have predictions.
    """
    order = np.argsort(run.of_impacts("K")["median"].to_numpy()[run.predicted], kind="stable")
    steps = np.linspace(0, len(order) - 1, min(PANELS, len(order))).round().astype(int)
    return [int(order[step]) for step in np.unique(steps)]


def one_step_p(run: FitRun) -> np.ndarray:
    """Ljung-Box p-values of the exact ARMA(2,1) fits' one-step residuals [impact], NaN where none is.

    Of a fit of decelerations, which no ARMA(2,1) is asked to describe, there are none.
    """
    if run.likelihood == "impact":
        return np.full(len(run.impacts), np.nan)
    table = run.estimates_exact.set_index("impact").reindex(run.impacts)
    if "whiteness_p" not in table:
        return np.full(len(table), np.nan)
    return pd.to_numeric(table["whiteness_p"], errors="coerce").to_numpy(float)


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


# Beyond this share of small p-values residuals as a whole are called structured.
_STRUCTURED_SHARE = 0.05


def other_noise(run: FitRun, left: Residuals) -> bool:
    """Whether the residuals' autocorrelation is not the model's; by chance in one of a hundred fits.

    Where the fit has tested each impact's residuals its verdict stands instead.
    """
    return not run.tested and left.other_noise_p < OTHER_NOISE


def residual_words(run: FitRun, left: Residuals, one_step: np.ndarray) -> list[str]:
    """Whether the residuals have structure, and whether the model expects what they have."""
    sentences = [
        f"{percent(inside_band(left))} of all measured samples lie in the predicted 90 % band of a new "
        "recording of the same impact, whose chain has errors of its own."
    ]
    if run.tested:
        return [*sentences, str(run.diagnostics["model_form"]["words"])]
    if np.isfinite(one_step).any():
        sentences.append(
            _structure("One step ahead, by the exact point fit", one_step, np.array(run.impacts))
        )
    table = left.lag_one
    inside = int(table["inside"].sum())
    words = f"The autocorrelation at lag 1 is what the model expects in {inside} of {len(table)} impacts"
    if other_noise(run, left):
        words += ": the noise that it assumes is not the noise that was recorded"
    return [*sentences, f"{words}."]


def _structure(what: str, p: np.ndarray, names: np.ndarray) -> str:
    tested = np.isfinite(p)
    count, total = int((p[tested] < STRUCTURED).sum()), int(tested.sum())
    # By Bonferroni: so small that among all of them not even one would be expected.
    sure = names[tested][p[tested] * total < STRUCTURED]
    if count > _STRUCTURED_SHARE * total:
        verdict = "the residuals have structure that a single trace's ARMA(2,1) does not explain"
    elif sure.size:
        verdict = f"structure beyond chance in {listed([str(name) for name in sure])} only"
    else:
        verdict = "no more structure than chance gives"
    return (
        f"{what}: {count} of {total} impacts have p below 0.01, where white residuals give about 1 %: "
        f"{verdict}."
    )
