from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset import write_dataset
from command_line import bayestissue
from dataset_bench import SETTINGS, samples_of


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four masses on a spring and damper, contact between two samples."""
    impacts = pd.DataFrame({"impact": list("abcd"), "subject": "s", "trial": list("1234")})
    impacts = impacts.assign(mass_kg=[0.375, 0.666, 1.0, 1.333], velocity_m_s=1.5)
    folder = tmp_path_factory.mktemp("lab") / "dataset"
    return written(folder, impacts, samples_of(impacts, late=0.00003))


def written(folder: Path, impacts: pd.DataFrame, traces: pd.DataFrame) -> Path:
    settings = {"name": folder.name, "signal": SETTINGS["signal"]}
    write_dataset(folder, settings=settings, impacts=impacts, traces=traces)
    return folder


@pytest.mark.slow
def test_writes_a_whole_run(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    ran = bayestissue("estimate", dataset, "--out", out, "--json")
    assert ran.status == 0
    names = {".bayestissue.json", "estimates.csv", "report.html", "run.json"}
    assert {path.name for path in out.iterdir()} == names
    table = pd.read_csv(out / "estimates.csv")
    # noise of a thousandth of the peak
    np.testing.assert_allclose(table["K_N_per_m"], 3000, rtol=0.01)
    np.testing.assert_allclose(table["C_N_s_per_m"], 25, rtol=0.01)
    assert json.loads(ran.out)[0]["impact"] == "a"
    about = json.loads((out / "run.json").read_text())
    assert about["kind"] == "estimates"
    assert about["method"] == "impact"
    assert re.fullmatch("[0-9a-f]{64}", about["input_hash"])
    assert about["model"]["signal"] == {"contact": "automatic", "window": "peak"}


def test_conditional_run_shows_what_centring_does(dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    ran = bayestissue("estimate", dataset, "--out", out, "--method", "dds")
    assert ran.status == 0
    assert "K (N/m)" in ran.out
    centring = pd.read_csv(out / "centring.csv")
    assert (centring["K_centred"] > 2 * centring["K_N_per_m"]).all()
    assert (pd.read_csv(out / "estimates.csv")["K_N_per_m"] > 6000).all()


@pytest.mark.parametrize(
    ("model", "says"),
    [
        ("nowhere.toml", "nowhere.toml"),
        ("impct", "Write impact for the one of that name"),
        ("elsewhere/impact.toml", "Write impact for the one that comes with the program"),
    ],
)
def test_wrong_choices_end_with_status_2_and_nothing_written(
    dataset: Path, tmp_path: Path, model: str, says: str
) -> None:
    out = tmp_path / "run"
    ran = bayestissue("estimate", dataset, "--out", out, "--model", model)
    assert (ran.status, says in ran.err) == (2, True)
    assert not out.exists()


@pytest.mark.slow
def test_bad_impacts_are_skipped_on_request_and_listed(dataset: Path, tmp_path: Path) -> None:
    spoilt = Path(shutil.copytree(dataset, tmp_path / "spoilt"))
    table = pd.read_csv(spoilt / "impacts.csv", dtype=str)
    table.loc[1, "mass_kg"] = "-1"
    table.to_csv(spoilt / "impacts.csv", index=False)
    out = tmp_path / "run"
    assert bayestissue("estimate", spoilt, "--out", out).status == 2
    assert not out.exists()
    assert bayestissue("estimate", spoilt, "--out", out, "--skip-bad", "--quiet").status == 0
    assert list(pd.read_csv(out / "estimates.csv")["impact"]) == ["a", "c", "d"]
    left_out = pd.read_csv(out / "left_out.csv")
    assert left_out["column"].tolist() == ["mass_kg"]
    assert left_out["row"].tolist() == [3]


def test_impacts_of_too_few_samples_have_rows_without_numbers(dataset: Path, tmp_path: Path) -> None:
    """All of them: up to their peak, at so low a rate, there are five and seven, and half are asked for."""
    impacts, traces = pd.read_csv(dataset / "impacts.csv")[:2], pd.read_csv(dataset / "traces.csv.gz")
    few = traces[traces["impact"].isin(impacts["impact"])].groupby("impact").nth(slice(3, None, 30))
    coarse = written(tmp_path / "coarse", impacts, few)
    out = tmp_path / "run"
    (half := tmp_path / "half.toml").write_text("[signal]\nwindow = 0.5\n", encoding="utf-8")
    ran = bayestissue("estimate", coarse, "--out", out, "--model", half)
    assert ran.status == 0
    table = pd.read_csv(out / "estimates.csv")
    assert (table["n_samples"] < 8).all()
    assert table["flags"].str.contains("fewer than 8 samples in the window").all()
    assert table.filter(regex="^[KC]_|_se$|phi|theta").isna().all(axis=None)
    assert "2 impacts, 2 flagged" in ran.out
    assert "No impact has K. Too few samples: Record faster" in ran.out
