"""`check` names spoilt impacts, what it does to K and C, and what to do."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd

from bayestissue.recordings.dataset import write_dataset
from command_line import bayestissue
from dataset_bench import SETTINGS, samples_of

NAMES = [f"i{number}" for number in range(14)]
SPOILT = ("i3", "i5")


def test_check_names_the_impacts_the_effect_and_the_remedy(tmp_path, monkeypatch):
    """Fourteen impacts on a spring and damper, two of them with a spike before contact."""
    monkeypatch.setenv("COLUMNS", "1000")
    impacts = pd.DataFrame({"impact": NAMES, "subject": "s", "trial": "t", "velocity_m_s": 1.0})
    impacts = impacts.assign(mass_kg=1 + 0.001 * np.arange(len(NAMES)))
    traces = samples_of(impacts)
    for name in SPOILT:
        mine = traces.index[traces["impact"] == name]
        traces.loc[mine[20], "value"] += 0.6 * traces.loc[mine, "value"].max()
    folder = tmp_path / "spoilt"
    settings = {"name": "spoilt", "signal": SETTINGS["signal"]}
    write_dataset(folder, settings=settings, impacts=impacts, traces=traces, trace_file="traces.csv")
    said = bayestissue("check", folder, "--out", tmp_path / "out").out
    assert 'impact i3: found "one at sample 21"' in said
    assert "The same in i5." in said
    assert "Take the impact out" in said
    assert set(pd.read_csv(tmp_path / "out" / "problems.csv")["impact"]) == set(SPOILT)
    quality = pd.read_csv(tmp_path / "out" / "quality.csv").set_index("impact")
    assert list(quality.index[quality["warnings"] > 0]) == list(SPOILT)
    assert "spike" in (tmp_path / "out" / "check.html").read_text(encoding="utf-8")
    plain = json.loads(bayestissue("check", folder, "--json").out)
    assert [problem["impact"] for problem in plain["warnings"]] == list(SPOILT)
