"""Patterns guessed from the names of recordings, and what init shows and writes without options."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.intake import Choices, prepare
from bayestissue.intake.names import guessed
from bayestissue.resources import shared
from command_line import bayestissue

RECORDED = shared("data", "tutorial", "recorded")


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        ("p1_operated_0.5kg p1_sound_0.5kg p2_sound_1.0kg", "{subject}_{side}_{mass_kg}kg"),
        ("anna-links-500g-1 anna-rechts-500g-2 bert-links-700g-1", "{subject}-{side}-{mass_g}g-{n}"),
        ("01_1 01_2 02_1", "{subject}_{n}"),
        ("s01_day1_left_0.5kg_r1 s01_day2_right_0.5kg_r2", None),
        (
            "s01_day1_left_0.5kg_r1 s01_day2_right_0.5kg_r2 s02_day2_right_0.5kg_r2",
            "{subject}_day{session}_{side}_{mass_kg}kg_r{n}",
        ),
        ("exp/max/L1 exp/max/R1 exp/eva/L2", "exp/{subject}/{group}"),
        ("s1_12cm_soft s1_15cm_hard s2_15cm_hard", "{subject}_{drop_height_cm}cm_{group}"),
        # A person each, or a count: it can't be told.
        ("rec1 rec2 rec3", None),
        ("a b_c", None),
        ("only_one", None),
    ],
)
def test_a_pattern_is_what_names_look_like(names: str, pattern: str | None) -> None:
    files = [SimpleNamespace(name=f"{name}.csv", suffix=".csv") for name in names.split()]
    assert guessed(files) == pattern


def test_what_is_given_otherwise_does_not_matter_in_names() -> None:
    files = [SimpleNamespace(name=f"p{n}_{s}_500g.csv", suffix=".csv") for n in (1, 2) for s in "lr"]
    assert guessed(files, {"mass_kg", "side"}) == "{subject}_{}_{}g"


def test_without_options_init_says_what_it_understood_and_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = bayestissue("init", RECORDED)
    assert found.status == 2
    assert "Names read as {subject}_{side}_{mass_kg}kg, a guess; --pattern takes another:" in found.err
    assert "subject: 6, p1 (4), p2 (4)" in found.err
    assert "mass_kg: 2, 0.5 (12), 1 (12)" in found.err
    assert "recordings of each combination: 1" in found.err
    assert "with your own values: --quantity deceleration --set velocity_m_s=1.5\n" in found.err
    assert not any(tmp_path.iterdir())


def test_what_is_left_out_has_a_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    asked = ["--quantity", "deceleration", "--set", "velocity_m_s=1.534", "--uncertainty", "velocity=0.01"]
    made = bayestissue("init", RECORDED, *asked)
    assert made.status == 0, made.err
    folder = tmp_path / "recorded-dataset"
    settings = tomllib.loads((folder / "dataset.toml").read_text())
    assert settings["name"] == "recorded-dataset"
    assert settings["uncertainty"] == {"velocity_sd_m_s": 0.01}
    assert "Before a fit" not in made.out
    data = bt.read_dataset(folder)
    assert set(data.impacts["trial"]) == {"0.5 kg", "1 kg"}
    # As many digits as two samples in the time to peak are worth.
    assert "15.5 to 30.3 ms" in made.out


def test_a_table_for_the_uncertainty_waits_where_none_was_stated(tmp_path: Path) -> None:
    bt.init_dataset(RECORDED, tmp_path / "d", quantity="deceleration", given={"velocity_m_s": 1.5})
    text = (tmp_path / "d" / "dataset.toml").read_text()
    rows = text[text.index("# [uncertainty]") :].splitlines()
    assert (
        tomllib.loads("\n".join(row.removeprefix("# ") for row in rows))["uncertainty"]["velocity_sd_m_s"]
        == 0.01
    )


def test_a_pattern_where_a_person_is_asked_for_is_one(tmp_path: Path) -> None:
    for number, path in enumerate(sorted(RECORDED.iterdir())[:3]):
        shutil.copyfile(path, tmp_path / f"rec{number}.lvm")
    intake = prepare(tmp_path, Choices(quantity="deceleration", shared={"velocity_m_s": "1", "mass_kg": "1"}))
    (question,) = intake.questions
    assert question.option == "--set subject="
    assert intake.answered(question, "{subject}.lvm").questions == ()


@pytest.mark.parametrize(
    ("mass", "velocity", "names"),
    [
        ([1, 1, 1, 1], [2, 2, 2, 2], ["all"] * 4),
        ([1, 1, 2, 2], [2, 2, 2, 2], ["1 kg", "1 kg", "2 kg", "2 kg"]),
        ([1, 1, 2, 2], [3, 3, 2, 2], ["1 kg, 3 m/s", "1 kg, 3 m/s", "2 kg, 2 m/s", "2 kg, 2 m/s"]),
        # Measured each by itself, a velocity is no condition.
        ([1, 1, 2, 2], [2.1, 2.2, 2.3, 2.4], ["1 kg", "1 kg", "2 kg", "2 kg"]),
    ],
)
def test_a_condition_that_is_left_out_is_a_mass_and_velocity(mass, velocity, names) -> None:
    table = pd.DataFrame({"impact": list("abcd"), "subject": "s", "mass_kg": mass, "velocity_m_s": velocity})
    t = np.arange(100) / 1e3
    traces = [(t, 50 * np.sin(np.pi * t / 0.1))] * 4
    assert bt.dataset(table, traces, quantity="deceleration", unit="m/s^2").impacts["trial"].tolist() == names
