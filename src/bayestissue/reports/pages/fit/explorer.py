"""What the page of a fit carries of single impacts, so that a reader can look at any of them."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.reports.figures.browser import by_column, packed
from bayestissue.reports.figures.impacts import factors
from bayestissue.reports.figures.traces import BANDS
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.fit.method_agreement import evenly_spaced
from bayestissue.reports.pages.fit.trace_predictions import trace_rows
from bayestissue.reports.pages.page_settings import LIMITS

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
