"""The page of `bayestissue init`: what was understood of a folder of recorder files."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from bayestissue.dataset import Dataset
from bayestissue.errors import Problem, by_cause
from bayestissue.report.page import render_page
from bayestissue.report.recordings.sheets import sheets
from bayestissue.report.style import FAINT, MUTED, PALETTE
from bayestissue.report.tables import Row, Table, columns
from bayestissue.signal import Displacements, displacements

MOST_PANELS = 120
_ROWS, _COLUMNS = 5, 2


def init_page(
    dataset: Dataset,
    *,
    understood: Sequence[tuple[str, str]],
    left_out: Sequence[Problem],
    notes: Sequence[str],
) -> str:
    """The whole page: what was understood, a panel for each impact, and the table of impacts.

    Args:
        dataset: as it was read back.
        understood: pairs of a heading and words.
        left_out: what was wrong with recordings that are not in the dataset.
        notes: what somebody should know who does not look at the panels.
    """
    total = len(dataset.impacts)
    which = np.arange(min(total, MOST_PANELS))
    signal = displacements(dataset)
    return render_page(
        "init.html",
        title=f"{dataset.name}: {total} impact{'s' if total > 1 else ''} from recorder files",
        contents=[("understood", "What was understood"), ("panels", "Recordings"), ("impacts", "Impacts")],
        understood=Table(
            columns("what", "understood as", words=("understood as",)), [Row(pair) for pair in understood]
        ),
        notes=notes,
        left_out=[str(problem) for problem in by_cause(left_out)],
        codes=[problem.code for problem in left_out],
        shown=len(which),
        total=total,
        sheets=sheets(
            list(dataset.impacts["impact"]),
            which,
            partial(_panel, dataset=dataset, signal=signal),
            rows=_ROWS,
            columns=_COLUMNS,
            size=(7.2, 0.7),
            alt="Recording with contact and peak",
            time="time on the recorder's clock, ms",
            value="displacement, mm" if dataset.quantity == "displacement" else "deceleration, m/s²",
        ),
        impacts=_impacts(dataset),
    )


def _panel(ax: Any, index: int, *, dataset: Dataset, signal: Displacements) -> None:
    trace = dataset.traces[index]
    factor = {"acceleration": -1.0, "displacement": 1e3}.get(dataset.quantity, 1.0)
    time, value = 1e3 * trace.time_s, factor * trace.value
    contact, to_peak = 1e3 * signal.contact_time_s[index], 1e3 * signal.time_to_peak[index]
    near = (time > contact - 2 * to_peak) & (time < contact + 4 * to_peak)
    near = near if near.any() else np.ones_like(near)
    peak = int(np.argmax(value))
    ax.plot(time[near], value[near], color=PALETTE[0], linewidth=1.1, label="recorded")
    ax.axvline(contact, color=MUTED, linewidth=0.9, linestyle="--", label="contact")
    ax.axhline(0, color=FAINT, linewidth=0.8)
    ax.plot(time[peak], value[peak], "v", color=PALETTE[3], markersize=5, label="peak")
    ax.tick_params(labelsize=7)


def _impacts(dataset: Dataset) -> Table:
    impacts = dataset.impacts.drop(
        columns=[name for name in dataset.impacts if dataset.impacts[name].isna().all()]
    )
    numbers = [str(name) for name in impacts if impacts[name].dtype.kind in "if"]
    return Table(
        columns(*impacts.columns, number=numbers),
        [
            Row([cell if isinstance(cell, str) else f"{cell:.6g}" for cell in record])
            for record in impacts.itertuples(index=False)
        ],
    )
