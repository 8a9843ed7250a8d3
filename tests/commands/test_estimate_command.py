from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue import cli
from bayestissue.mechanics.oscillator import impact_motion, spring_damper_inverse
from bayestissue.recordings.dataset import write_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab") / "dataset"
    mass = np.array([0.375, 0.666, 1.0, 1.333])
    omega_n, zeta = (np.asarray(p) for p in spring_damper_inverse(3000.0, 25.0, mass))
    time = np.arange(500) * 1e-4
    since = time - 0.00303
    motion = impact_motion(np.maximum(since, 0), omega_n[:, None], zeta[:, None], 1.5)
    d = np.where(since >= 0, np.asarray(motion.deceleration), 0.0)
    d += 0.1 * np.random.default_rng(0).normal(size=d.shape)
    names = ["a", "b", "c", "d"]
    impacts = pd.DataFrame(
        {"impact": names, "subject": "s", "trial": ["1", "2", "3", "4"], "mass_kg": mass, "velocity_m_s": 1.5}
    )
    traces = pd.DataFrame(
        {"impact": np.repeat(names, len(time)), "time_s": np.tile(time, 4), "value": d.ravel()}
    )
    settings = {"name": "four masses", "signal": {"quantity": "deceleration", "unit": "m/s^2"}}
    write_dataset(folder, settings=settings, impacts=impacts, traces=traces)
    return folder


def bayestissue(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    monkeypatch.setattr(sys, "argv", ["bayestissue", *map(str, arguments)])
    try:
        cli.main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.mark.slow
def test_writes_a_whole_run(dataset: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    out = tmp_path / "run"
    assert bayestissue(monkeypatch, "estimate", dataset, "--out", out, "--json") == 0
    assert sorted(path.name for path in out.iterdir()) == [
        ".bayestissue.json",
        "estimates.csv",
        "report.html",
        "run.json",
    ]
    table = pd.read_csv(out / "estimates.csv")
    # noise of a thousandth of the peak
    np.testing.assert_allclose(table["K_N_per_m"], 3000, rtol=0.01)
    np.testing.assert_allclose(table["C_N_s_per_m"], 25, rtol=0.01)
    assert json.loads(capsys.readouterr().out)[0]["impact"] == "a"
    about = json.loads((out / "run.json").read_text())
    assert about["kind"] == "estimates"
    assert about["method"] == "impact"
    assert re.fullmatch("[0-9a-f]{64}", about["input_hash"])
    assert about["model"]["signal"] == {"contact": "automatic", "window": "peak"}


@pytest.mark.slow
def test_conditional_run_shows_what_centring_does(dataset: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    out = tmp_path / "run"
    assert bayestissue(monkeypatch, "estimate", dataset, "--out", out, "--method", "dds") == 0
    assert "K (N/m)" in capsys.readouterr().out
    centring = pd.read_csv(out / "centring.csv")
    assert (centring["K_centred"] > 2 * centring["K_N_per_m"]).all()
    assert (pd.read_csv(out / "estimates.csv")["K_N_per_m"] > 6000).all()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--model", "nowhere.toml"], "nowhere.toml"),
        (["--model", "impct"], "Write impact for the one of that name"),
        (["--model", "elsewhere/impact.toml"], "Write impact for the one that comes with the program"),
    ],
)
def test_wrong_choices_end_with_status_2_and_nothing_written(
    dataset: Path, tmp_path: Path, monkeypatch, capsys, arguments: list[str], says: str
) -> None:
    out = tmp_path / "run"
    assert bayestissue(monkeypatch, "estimate", dataset, "--out", out, *arguments) == 2
    assert says in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
def test_bad_impacts_are_skipped_on_request_and_listed(
    dataset: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    spoilt = tmp_path / "spoilt"
    spoilt.mkdir()
    for path in dataset.iterdir():
        (spoilt / path.name).write_bytes(path.read_bytes())
    table = pd.read_csv(spoilt / "impacts.csv", dtype=str)
    table.loc[1, "mass_kg"] = "-1"
    table.to_csv(spoilt / "impacts.csv", index=False)
    out = tmp_path / "run"
    assert bayestissue(monkeypatch, "estimate", spoilt, "--out", out) == 2
    assert not out.exists()
    assert bayestissue(monkeypatch, "estimate", spoilt, "--out", out, "--skip-bad", "--quiet") == 0
    assert list(pd.read_csv(out / "estimates.csv")["impact"]) == ["a", "c", "d"]
    left_out = pd.read_csv(out / "left_out.csv")
    assert left_out["column"].tolist() == ["mass_kg"]
    assert left_out["row"].tolist() == [3]


def test_impacts_of_too_few_samples_have_rows_without_numbers(
    dataset: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    """All of them: up to their peak, at so low a rate, there are five and seven, and half are asked for."""
    impacts, traces = pd.read_csv(dataset / "impacts.csv")[:2], pd.read_csv(dataset / "traces.csv.gz")
    few = traces[traces["impact"].isin(impacts["impact"])].groupby("impact").nth(slice(3, None, 30))
    coarse = tmp_path / "coarse"
    settings = {"name": "coarse", "signal": {"quantity": "deceleration", "unit": "m/s^2"}}
    write_dataset(coarse, settings=settings, impacts=impacts, traces=few)
    out = tmp_path / "run"
    (half := tmp_path / "half.toml").write_text("[signal]\nwindow = 0.5\n", encoding="utf-8")
    assert bayestissue(monkeypatch, "estimate", coarse, "--out", out, "--model", half) == 0
    table = pd.read_csv(out / "estimates.csv")
    assert (table["n_samples"] < 8).all()
    assert table["flags"].str.contains("fewer than 8 samples in the window").all()
    assert table.filter(regex="^[KC]_|_se$|phi|theta").isna().all(axis=None)
    printed = capsys.readouterr().out
    assert "2 impacts, 2 flagged" in printed
    assert "No impact has K. Too few samples: Record faster" in printed
    # Without that choice the rebound is taken along.
    assert bayestissue(monkeypatch, "estimate", coarse, "--out", tmp_path / "whole") == 0
    assert pd.read_csv(tmp_path / "whole" / "estimates.csv")["K_N_per_m"].notna().all()
    assert "the window goes on to the rebound in 2 of 2 impacts" in capsys.readouterr().out


def test_one_impact_is_said_to_be_one(dataset: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    impacts, traces = pd.read_csv(dataset / "impacts.csv")[:2], pd.read_csv(dataset / "traces.csv.gz")
    impacts.loc[1, "mass_kg"] = -1.0
    settings = {"name": "one", "signal": {"quantity": "deceleration", "unit": "m/s^2"}}
    traces = traces[traces["impact"].isin(impacts["impact"])]
    write_dataset(tmp_path / "one", settings=settings, impacts=impacts, traces=traces)
    assert bayestissue(monkeypatch, "check", tmp_path / "one", "--skip-bad") == 0
    assert "without the 1 impact left out" in " ".join(capsys.readouterr().out.split())
    out = tmp_path / "run"
    assert bayestissue(monkeypatch, "estimate", tmp_path / "one", "--out", out, "--skip-bad") == 0
    assert "one: 1 impact, " in capsys.readouterr().out


def test_a_folder_that_is_not_empty_is_not_replaced(dataset: Path, tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    assert bayestissue(monkeypatch, "estimate", dataset, "--out", tmp_path) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.slow
def test_recorded_heel_strikes_have_estimates(heel_strikes: Path, tmp_path: Path, monkeypatch) -> None:
    assert bayestissue(monkeypatch, "estimate", heel_strikes, "--out", tmp_path / "run", "--quiet") == 0
    table = pd.read_csv(tmp_path / "run" / "estimates.csv")
    assert len(table) == 216
    # Some thirty samples each tell K of most of them, and C of few.
    assert (table["K_N_per_m"] > 0).mean() > 0.7
    assert np.isfinite(table["K_high_N_per_m"]).all()
