from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue import cli
from bayestissue.dataset import write_dataset
from bayestissue.resources import shared
from bayestissue.simulation import Simulation, simulate
from bayestissue.thesis.causes import verdict
from page_reader import Reader

pytestmark = pytest.mark.slow

FILES = [
    ".bayestissue.json", "campaigns.parquet", "causes.csv", "confusion.csv", "observed.csv", "predictive.csv",
    "reliability.csv", "report.html", "run.json",
]  # fmt: skip


def bayestissue(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    monkeypatch.setattr(sys, "argv", ["bayestissue", *map(str, arguments)])
    # The suite keeps the cores that it has.
    monkeypatch.setattr("bayestissue.runtime.configure", lambda **_: None)
    try:
        cli.main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def few(folder: Path, *names: str) -> list[str | Path]:
    """Options for a few short campaigns of these causes."""
    model = folder / "causes.toml"
    text = shared("models", "causes.toml").read_text(encoding="utf-8")
    model.write_text(text.replace("low = 16, high = 160", "low = 16, high = 20"), encoding="utf-8")
    chosen: list[str | Path] = [part for name in names for part in ("--cause", name)]
    return [*chosen, "--model", model, "--campaigns", "50", "--jobs", "1"]


@pytest.fixture(scope="module", autouse=True)
def _few_networks() -> Iterator[None]:
    """How well networks tell causes apart is tested with them; here it is what becomes of their answer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verdict, "SETTINGS", replace(verdict.SETTINGS, networks=1))
        yield


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    tmp_path = tmp_path_factory.mktemp("causes")
    out = tmp_path / "run"
    arguments = few(tmp_path, "centring", "own_time")
    with pytest.MonkeyPatch.context() as patch:
        assert bayestissue(patch, "causes", "published", "--out", out, "--quiet", *arguments) == 0
    return out


def test_writes_a_whole_run(published: Path) -> None:
    assert sorted(path.name for path in published.iterdir()) == FILES
    assert not (published.parent / ".run.unfinished").exists()
    causes = pd.read_csv(published / "causes.csv")
    assert list(causes["cause"]) == ["centring", "own_time"]
    assert causes["probability"].sum() == pytest.approx(1)
    # Centring alone leaves K/M scattered ninefold as much as observed.
    assert causes.set_index("cause").loc["own_time", "probability"] > 0.9
    campaigns = pd.read_parquet(published / "campaigns.parquet")
    assert campaigns["cause"].value_counts().to_dict() == {"centring": 50, "own_time": 50}
    assert set(campaigns["seed"]) == {0}
    about = json.loads((published / "run.json").read_text())
    assert about["kind"] == "causes"
    assert about["model"]["campaigns"]["each"] == 50


def test_the_same_seed_gives_the_same_bytes(published: Path, tmp_path: Path, monkeypatch) -> None:
    again = tmp_path / "again"
    arguments = few(tmp_path, "centring", "own_time")
    assert bayestissue(monkeypatch, "causes", "published", "--out", again, "--quiet", *arguments) == 0
    for name in FILES:
        if name.endswith(("csv", "parquet")):
            assert (again / name).read_bytes() == (published / name).read_bytes()


def test_the_page_answers_and_is_made_anew_without_the_campaigns(published: Path, monkeypatch) -> None:
    first = (published / "report.html").read_text(encoding="utf-8")
    assert "Why does K grow with mass?" in first
    assert "K goes with the mass to the power 0.96" in first
    page = Reader()
    page.feed(first)
    assert page.open == []
    assert page.unnamed == 0
    assert len(set(page.ids)) == len(page.ids)
    assert {link[1:] for link in page.links} <= set(page.ids)
    (published / "campaigns.parquet").rename(published.parent / "aside")
    try:
        assert bayestissue(monkeypatch, "report", published, "--quiet") == 0
    finally:
        (published.parent / "aside").rename(published / "campaigns.parquet")
    assert (published / "report.html").read_text(encoding="utf-8") == first


def test_refuses_what_it_does_not_know(tmp_path: Path, monkeypatch, capsys) -> None:
    out = tmp_path / "run"
    assert bayestissue(monkeypatch, "causes", "published", "--out", out, "--cause", "magic") == 2
    assert "centring" in capsys.readouterr().err
    assert not out.exists()
    model = tmp_path / "model.toml"
    model.write_text('[causes.a]\nmechanism = "wall"\nwords = "w"\n')
    assert bayestissue(monkeypatch, "causes", "published", "--out", out, "--model", model) == 2
    told = capsys.readouterr().err
    assert "thickness_over_depth" in told
    assert "tissue" in told


def lab(folder: Path, masses: tuple[float, ...], exponent: float) -> Path:
    simulation = Simulation.model_validate(
        {
            "name": "lab",
            "seed": 4,
            "design": {
                "subjects": 4,
                "conditions": [
                    {"trial": f"{mass:g} kg", "mass_kg": mass, "velocity_m_s": 1 + 0.5 * (k % 2)}
                    for k, mass in enumerate(masses)
                ],
            },
            "tissue": {
                "K_N_per_m": 3000, "C_N_s_per_m": 25,
                "mass_exponent_K": exponent, "mass_exponent_C": exponent,
                "sd_subject_K": 0.1, "sd_subject_C": 0.1, "sd_impact_K": 0.02, "sd_impact_C": 0.05,
            },
            "recording": {"sampling_rate_hz": 2500, "noise_relative_to_peak": 0.002},
        }
    )  # fmt: skip
    campaign = simulate(simulation)
    settings = {"name": "lab", "signal": {"quantity": "deceleration", "unit": "m/s^2"}}
    write_dataset(folder, settings=settings, impacts=campaign.impacts, traces=campaign.traces())
    return folder


@pytest.mark.long
def test_a_dataset_of_tense_muscles_is_attributed_to_them(tmp_path: Path, monkeypatch, capsys) -> None:
    data = lab(tmp_path / "lab", (0.4, 0.7, 1.0, 1.3, 1.6), exponent=0.8)
    out = tmp_path / "run"
    arguments = few(tmp_path, "none", "centring", "anticipation", "reflex_energy")
    assert bayestissue(monkeypatch, "causes", data, "--out", out, "--json", *arguments) == 0
    causes = pd.read_csv(out / "causes.csv").set_index("cause")
    # The exact method doesn't centre, so centring is no cause of what it gives.
    assert list(causes.index) == ["none", "anticipation", "reflex_energy"]
    assert causes["probability"].idxmax() == "anticipation"
    assert causes.loc["anticipation", "verdict"] != "refuted"
    assert causes.loc["none", "p_joint"] == pytest.approx(causes.loc["none", "smallest_p"])
    assert [row["cause"] for row in json.loads(capsys.readouterr().out)] == list(causes.index)
    observed = pd.read_csv(out / "observed.csv").set_index("statistic")["value"]
    # Five masses and four people with 2 % of own scatter.
    assert observed["mass_exponent_K"] == pytest.approx(0.8, abs=4 * 0.02 / np.sqrt(20) / 0.49)


def test_a_dataset_of_one_mass_has_nothing_to_explain(tmp_path: Path, monkeypatch, capsys) -> None:
    data = lab(tmp_path / "lab", (0.7, 0.9), exponent=0)
    assert bayestissue(monkeypatch, "causes", data, "--out", tmp_path / "run") == 2
    assert "at least 3 masses" in capsys.readouterr().err
