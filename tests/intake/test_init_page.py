"""The page of `bayestissue init`, drawn."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from bayestissue.base.errors import Problem
from bayestissue.recordings.dataset import read_dataset, write_dataset
from bayestissue.recordings.signal import displacements
from bayestissue.reports.pages.recordings_pages import init_page
from dataset_bench import NAMES, SETTINGS, tables
from page_reader import figures


def test_the_page_shows_every_impact_and_what_was_understood(tmp_path: Path) -> None:
    impacts, traces = tables()
    write_dataset(tmp_path, settings=SETTINGS, impacts=impacts, traces=traces)
    data = read_dataset(tmp_path)
    page = init_page(
        data,
        displacements(data),
        understood=[("values", "deceleration, channel <A&B>, in g")],
        left_out=[
            Problem("e.lvm", "a whole .lvm file", "Copy it anew.", value="<nothing>", code="damaged-file")
        ],
        notes=["a note"],
    )
    assert f"Recording with contact and peak for the impacts {', '.join(NAMES)}." in page
    assert "channel &lt;A&amp;B&gt;, in g" in page
    assert "&lt;nothing&gt;" in page
    assert "<p>a note</p>" in page
    (chart,) = map(json.loads, figures(page))
    rows = pd.DataFrame(chart["datasets"]["rows-0"])
    assert tuple(rows["impact"].unique()) == NAMES
    # Of each impact the highest sample stands where the recording is highest.
    values = rows.set_index("impact")["value"]
    recorded, peak = (values[(rows["kind"] == kind).to_numpy()] for kind in ("recorded", "peak"))
    pd.testing.assert_series_equal(recorded.groupby(level=0).max(), peak.sort_index())
