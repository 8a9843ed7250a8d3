"""`check` and `estimate` name spoilt impacts alike, and say once what the method shows on all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset import write_dataset
from command_line import bayestissue
from dataset_bench import SETTINGS, samples_of

NAMES = [f"i{number}" for number in range(14)]
SPOILT = ("i3", "i5")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fourteen impacts on a spring and damper, two of them with a spike before contact."""
    impacts = pd.DataFrame({"impact": NAMES, "subject": "s", "trial": "t", "velocity_m_s": 1.0})
    impacts = impacts.assign(mass_kg=1 + 0.001 * np.arange(len(NAMES)))
    traces = samples_of(impacts)
    for name in SPOILT:
        mine = traces.index[traces["impact"] == name]
        traces.loc[mine[20], "value"] += 0.6 * traces.loc[mine, "value"].max()
    made = tmp_path_factory.mktemp("data") / "spoilt"
    settings = {"name": "spoilt", "signal": SETTINGS["signal"]}
    write_dataset(made, settings=settings, impacts=impacts, traces=traces, trace_file="traces.csv")
    return made


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "1000")


def test_check_names_the_impacts_the_effect_and_the_remedy(folder, tmp_path):
    said = bayestissue("check", folder, "--out", tmp_path / "out").out
    assert 'impact i3: found "one at sample 21"' in said
    assert "The same in i5." in said
    assert "change K and C" in said
    assert "Take the impact out" in said
    problems = pd.read_csv(tmp_path / "out" / "problems.csv")
    assert set(problems["impact"]) == set(SPOILT)
    quality = pd.read_csv(tmp_path / "out" / "quality.csv").set_index("impact")
    assert list(quality.index[quality["warnings"] > 0]) == list(SPOILT)
    assert "spike" in (tmp_path / "out" / "check.html").read_text(encoding="utf-8")
    plain = json.loads(bayestissue("check", folder, "--json").out)
    assert [problem["impact"] for problem in plain["warnings"]] == list(SPOILT)


def test_estimate_flags_these_impacts_alone_and_says_the_methods_part_once(folder, tmp_path):
    said = bayestissue("estimate", folder, "--method", "dds", "--out", tmp_path / "out").out
    assert "14 impacts, 2 flagged" in said
    assert said.count("K and C imply another peak displacement than recorded in ") == 1
    table = pd.read_csv(tmp_path / "out" / "estimates.csv", keep_default_na=False).set_index("impact")
    assert list(table.index[table["flags"] != ""]) == list(SPOILT)
    assert set(table.loc[list(SPOILT), "flags"]) == {"a spike of one to three samples"}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "2 of 14 flagged" in page
    assert page.count("K and C imply another peak displacement than recorded in ") == 1
