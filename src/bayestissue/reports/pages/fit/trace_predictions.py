"""What the model predicts of each trace, what is left over of it, and what a page carries of both."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from bayestissue.base.impact_arrays import evenly_spaced
from bayestissue.inference.points.whiteness import autocorrelation
from bayestissue.reports.figures.browser import by_column, packed
from bayestissue.reports.figures.impacts import factors
from bayestissue.reports.figures.traces import BANDS
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.page_settings import LIMITS

STRUCTURED = 0.01
OTHER_NOISE = 0.01


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
        from scipy.special import chdtrc

        replicated, measured = self._lag_one
        draws = len(replicated)
        above = (replicated > measured).sum(axis=0)
        nearer = np.minimum(above, draws - above)
        p = np.minimum(2 * (nearer + 1) / (draws + 1), 1.0)[np.isfinite(measured)]
        return float(chdtrc(2 * p.size, -2 * np.log(p).sum())) if p.size else 1.0


def residuals(run: FitRun) -> Residuals:
    """The residuals of every impact, or of 250 evenly spaced ones if there are more."""
    which = evenly_spaced(len(run.predicted), LIMITS.impacts_tested)
    replicates = run.draws(run.shown, "posterior_predictive")[:, which].astype(float)
    middle = np.median(replicates, axis=0)
    measured = run.groups["observed_data"][run.shown].to_numpy()[which]
    return Residuals(measured - middle, replicates - middle, run.predicted[which])


def inside_band(left: Residuals) -> float:
    """The share of all measured samples inside the replicates' 90 % band."""
    low, high = np.percentile(left.replicated, [5, 95], axis=0)
    inside = (left.measured >= low) & (left.measured <= high)
    return float(inside[left.used].mean())


def middle_impact(run: FitRun) -> int:
    """The impact of the median stiffness, as a number among those that have predictions."""
    order = np.argsort(run.estimates_by_method["K"]["median"].to_numpy()[run.predicted], kind="stable")
    return int(order[len(order) // 2])


def force_impact(run: FitRun) -> int:
    """The impact whose force is shown: where that follows another law the worst, else the median one."""
    p = run.force_form["impacts"]["p"]
    names = [run.impacts[row] for row in run.predicted]
    worst = min((name for name in names if name in p), key=lambda name: p[name], default=None)
    followed = run.diagnostics["channels"]["follows"]
    return middle_impact(run) if followed or worst is None else names.index(worst)


SCALES = {"deceleration": ("m/s²", 1.0), "force": ("N", 1.0), "displacement": ("mm", 1e3)}


def trace_rows(
    run: FitRun,
    index: int,
    replicates: Float[np.ndarray, "draw sample"] | None = None,
    *,
    what: str | None = None,
) -> pd.DataFrame:
    """One of the impacts that have predictions: ``time_ms``, ``recorded`` and `BANDS` of its replicates.

    Args:
        run: a finished fit.
        index: of the impact, among those.
        replicates: of it, where they are at hand.
        what: "force" for one beside what the fit is shown by.
    """
    what = what or run.shown
    scale = SCALES[what][1]
    if replicates is None:
        replicates = run.draws(what, "posterior_predictive")[:, index]
    bands = scale * np.percentile(replicates.astype(float), list(BANDS.values()), axis=0)
    rows = pd.DataFrame(
        {
            "time_ms": 1e3 * run.times(what)[run.predicted[index]],
            "recorded": scale * run.groups["observed_data"][what].to_numpy()[index],
        }
        | dict(zip(BANDS, bands, strict=True))
    )
    return rows[np.isfinite(rows).all(axis=1)].reset_index(drop=True)


def other_noise(run: FitRun, left: Residuals) -> bool:
    """Whether the residuals' autocorrelation is not the model's; by chance in one of a hundred fits.

    Where the fit has tested each impact's residuals its verdict stands instead.
    """
    return not run.tested and left.other_noise_p < OTHER_NOISE


# Numbers of recordings and of their bands in one page: some 6 MB of it.
MOST_VALUES = 2_500_000


def carried(run: FitRun) -> np.ndarray:
    """The impacts whose recordings the page holds, as numbers among those that have predictions.

    All of them, or as many as `MOST_VALUES` allows, evenly spaced.
    """
    samples = np.isfinite(run.times()[run.predicted]).sum(axis=1)
    size = int(samples.sum()) * (1 + len(BANDS))
    count = len(run.predicted)
    return evenly_spaced(count, count if size <= MOST_VALUES else max(int(count * MOST_VALUES / size), 1))


def packed_impacts(run: FitRun, table: pd.DataFrame) -> str:
    """The impacts' ``table`` and their recordings, `packed` for the script of the page.

    Four bytes with the length of a JSON text; the text; then whole numbers as `_differences`: of each carried
    impact the predicted median, the recording less it, and the other `BANDS` less it, each as many as its
    samples. The median times the first of an impact's ``steps``, and the others times the second, are in the
    unit that the page shows.
    """
    replicates, others = (
        run.draws(run.shown, "posterior_predictive"),
        [name for name in BANDS if name != "median"],
    )
    traces, values = [], []
    for index in carried(run):
        rows = trace_rows(run, index, replicates[:, index])
        left = rows[["recorded", *others]].sub(rows["median"], axis=0)
        parts = rows[["median"]].to_numpy().T, left.to_numpy().T
        steps = [
            float(np.abs(part).max(initial=0) / count) or 1.0
            for part, count in zip(parts, LIMITS.steps, strict=True)
        ]
        at = rows["time_ms"].to_numpy()
        traces.append(
            {
                "impact": int(run.predicted[index]),
                "samples": int(at.size),
                "first": float(at[0]) if at.size else 0.0,
                "interval": float((at[-1] - at[0]) / max(at.size - 1, 1)) if at.size else 1.0,
                "steps": steps,
            }
        )
        values += [np.round(part / step).ravel() for part, step in zip(parts, steps, strict=True)]
    header: dict[str, Any] = {
        "impacts": by_column(json.loads(table.to_json(orient="records", double_precision=15))),
        "factors": factors(table),
        "bands": others,
        "tested": run.tested,
        "traces": traces,
    }
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    return packed(struct.pack("<I", len(text)) + text + _differences(np.concatenate([[], *values])))


def _differences(numbers: np.ndarray) -> bytes:
    """What each of whole ``numbers`` adds to the one before, in two bytes: all low ones, then all high ones.

    The lowest bit is the sign, so that the high bytes are mostly 0, which packs well.
    """
    added: np.ndarray = np.diff(numbers.astype(np.int32), prepend=0)
    return ((added << 1) ^ (added >> 31)).astype("<u2").view(np.uint8).reshape(-1, 2).T.tobytes()
