"""`check` and `estimate` name spoilt impacts alike, and say once what the method shows on all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue import cli
from bayestissue.recordings.dataset import write_dataset

NAMES = [f"i{number}" for number in range(14)]
RATE, SPOILT = 10_000.0, ("i3", "i5")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fourteen impacts on a spring and damper, two of them with a spike before contact."""
    rng = np.random.default_rng(2)
    time = np.arange(600) / RATE
    since = np.maximum(time - 0.02, 0)
    frequency, ratio = np.sqrt(3000.0), 0.25
    damped = frequency * np.sqrt(1 - ratio**2)
    decay = np.exp(-ratio * frequency * since)
    x = decay / damped * np.sin(damped * since)
    v = decay * (np.cos(damped * since) - ratio * frequency / damped * np.sin(damped * since))
    force = np.where(time >= 0.02, np.maximum(3000 * x + 2 * ratio * frequency * v, 0), 0)
    values = force + 0.005 * force.max() * rng.standard_normal((len(NAMES), time.size))
    for name in SPOILT:
        values[NAMES.index(name), 90] += 0.6 * force.max()
    impacts = pd.DataFrame(
        {"impact": NAMES, "subject": "s", "trial": "t", "mass_kg": 1.0, "velocity_m_s": 1.0}
    )
    traces = pd.DataFrame(
        {
            "impact": np.repeat(NAMES, time.size),
            "time_s": np.tile(time, len(NAMES)),
            "value": values.ravel(),
        }
    )
    made = tmp_path_factory.mktemp("data") / "spoilt"
    settings = {"name": "spoilt", "signal": {"quantity": "deceleration", "unit": "m/s^2"}}
    write_dataset(made, settings=settings, impacts=impacts, traces=traces, trace_file="traces.csv")
    return made


def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> str:
    monkeypatch.setattr("sys.argv", ["bayestissue", *map(str, arguments)])
    monkeypatch.setenv("COLUMNS", "1000")
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code
    return capsys.readouterr().out


def test_check_names_the_impacts_the_effect_and_the_remedy(folder, tmp_path, capsys, monkeypatch):
    said = run(capsys, monkeypatch, "check", folder, "--out", tmp_path / "out")
    assert 'impact i3: found "one at sample 91"' in said
    assert "The same in i5." in said
    assert "change K and C" in said
    assert "Take the impact out" in said
    problems = pd.read_csv(tmp_path / "out" / "problems.csv")
    assert set(problems["impact"]) == set(SPOILT)
    quality = pd.read_csv(tmp_path / "out" / "quality.csv").set_index("impact")
    assert list(quality.index[quality["warnings"] > 0]) == list(SPOILT)
    assert "spike" in (tmp_path / "out" / "check.html").read_text(encoding="utf-8")
    plain = json.loads(run(capsys, monkeypatch, "check", folder, "--json"))
    assert [problem["impact"] for problem in plain["warnings"]] == list(SPOILT)


def test_estimate_flags_these_impacts_alone_and_says_the_methods_part_once(
    folder, tmp_path, capsys, monkeypatch
):
    said = run(capsys, monkeypatch, "estimate", folder, "--method", "dds", "--out", tmp_path / "out")
    assert "14 impacts, 2 flagged" in said
    assert said.count("K and C imply another peak displacement than recorded in ") == 1
    table = pd.read_csv(tmp_path / "out" / "estimates.csv", keep_default_na=False).set_index("impact")
    assert list(table.index[table["flags"] != ""]) == list(SPOILT)
    assert set(table.loc[list(SPOILT), "flags"]) == {"a spike of one to three samples"}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "2 of 14 flagged" in page
    assert page.count("K and C imply another peak displacement than recorded in ") == 1
