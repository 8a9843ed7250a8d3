"""What the page of a fit carries of single impacts, so that a reader can look at any of them."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.reports.figures.browser import packed
from bayestissue.reports.figures.impacts import factors
from bayestissue.reports.figures.traces import BANDS
from bayestissue.reports.pages.fit.estimates import evenly_spaced
from bayestissue.reports.pages.fit.run import FitRun
from bayestissue.reports.pages.fit.traces import trace_rows
from bayestissue.reports.pages.settings import LIMITS

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


def carried_words(run: FitRun) -> str:
    """Of which impacts the page has recordings; empty where of all."""
    shown, total = len(carried(run)), len(run.impacts)
    words = f"Recordings of {shown} of {total} impacts, evenly spaced, are in this page."
    return "" if shown == total else words


def packed_impacts(run: FitRun, table: pd.DataFrame) -> str:
    """The impacts' ``table`` and their recordings, `packed` for the script of the page.

    Four bytes with the length of a JSON text; the text; then whole numbers of two bytes: of each carried
    impact the predicted median, the recording less it, and the other `BANDS` less it, each as many as its
    samples. An impact's numbers times its ``step`` are in the unit that the page shows.
    """
    replicates, others = (
        run.draws(run.shown, "posterior_predictive"),
        [name for name in BANDS if name != "median"],
    )
    traces, values = [], []
    for index in carried(run):
        rows = trace_rows(run, index, replicates[:, index])
        left = rows[["recorded", *others]].sub(rows["median"], axis=0)
        numbers = np.vstack([rows["median"], left.to_numpy().T])
        step = float(np.abs(numbers).max(initial=0) / LIMITS.steps) or 1.0
        at = rows["time_ms"].to_numpy()
        traces.append(
            {
                "impact": int(run.predicted[index]),
                "samples": int(at.size),
                "first": float(at[0]) if at.size else 0.0,
                "interval": float((at[-1] - at[0]) / max(at.size - 1, 1)) if at.size else 1.0,
                "step": step,
            }
        )
        values.append(np.round(numbers / step).astype("<i2").ravel())
    header: dict[str, Any] = {
        "impacts": json.loads(table.to_json(orient="records", double_precision=6)),
        "factors": factors(table),
        "bands": others,
        "tested": run.tested,
        "traces": traces,
    }
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (len(text) % 2)
    return packed(
        struct.pack("<I", len(text)) + text + np.concatenate(values or [np.array([], "<i2")]).tobytes()
    )
