"""Masses that rest on tissue and are tapped by an instrumented hammer: read, refused, written back."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.dataset import read_dataset
from bayestissue.errors import InputError
from bayestissue.simulation import Simulation, simulate, write_campaign

CHAIN = {
    "relative_mass_sd": 1.0,
    "noise_sd_m_s2": 0.02,
    "force": {"place": "hammer", "noise_sd_N": 0.1, "relative_gain_sd": 0.02},
}
TAPS = Simulation(
    name="taps",
    design={"subjects": 2, "conditions": ({"trial": "tap", "mass_kg": 2.0, "impulse_N_s": 0.4},)},
    tissue={"K_N_per_m": 8000.0, "C_N_s_per_m": 20.0},
    tap={"duration_s": 0.005, "ringing_s": 0.1},
    recording=CHAIN,
    output={"traces": "csv"},
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_campaign(tmp_path / "taps", simulate(TAPS), TAPS)
    return tmp_path / "taps"


def changed(folder: Path, pattern: str, text: str, file: str = "dataset.toml") -> Path:
    before = (folder / file).read_text()
    after = re.sub(pattern, text, before, count=1)
    assert after != before
    (folder / file).write_text(after)
    return folder


def refused(folder: Path) -> dict[str, Any]:
    with pytest.raises(InputError) as error:
        read_dataset(folder)
    (problem,) = error.value.problems
    return problem.as_dict() | {"text": str(problem), "code": problem.code, "row": problem.row}


def test_it_is_read_without_velocities_and_written_back(folder: Path) -> None:
    data = read_dataset(folder)
    assert data.tapped
    assert data.recorded == "tapped"
    assert data.free
    assert data.uncertainty.relative_mass_sd == 1.0
    assert data.impacts["velocity_m_s"].isna().all()
    assert "tapped by a hammer" in repr(data)
    assert "velocity" not in repr(data)
    again = read_dataset(data.write(folder.parent / "again"))
    assert again.recorded == "tapped"
    assert again.uncertainty == data.uncertainty
    assert "velocity_m_s" not in (folder.parent / "again" / "impacts.csv").read_text()
    for one, other in zip(data.channels[0].traces, again.channels[0].traces, strict=True):
        np.testing.assert_allclose(one.value, other.value, rtol=1e-12)


def test_velocities_that_stand_there_are_not_read(folder: Path) -> None:
    table = pd.read_csv(folder / "impacts.csv").assign(velocity_m_s="fast")
    table.to_csv(folder / "impacts.csv", index=False)
    assert read_dataset(folder).impacts["velocity_m_s"].isna().all()


def test_the_mass_is_needed(folder: Path) -> None:
    pd.read_csv(folder / "impacts.csv").drop(columns="mass_kg").to_csv(folder / "impacts.csv", index=False)
    assert "mass_kg" in refused(folder)["text"]


@pytest.mark.parametrize(
    ("pattern", "text", "column", "row", "words"),
    [
        ('"acceleration"', '"deceleration"', "signal.quantity", 6, "no other quantity"),
        (r"\[signal\]", '[signal]\ngravity = "drop"', "signal.gravity", 6, "gravity changes nothing"),
        (r"\[signal\]", "[signal]\ngravity = 9.81", "signal.gravity", 6, "Leave gravity out"),
        (r"\n\[\[", "\n[motion]\nfree = false\n\n[[", "motion.free", 16, "the hammer and the tissue alone"),
        (r"\n\[\[", "\n[impactor]\nheadform = true\n\n[[", "impactor.headform", 16, "Leave headform out"),
        (
            r"\n\[\[",
            "\n[recorder]\nlow_pass_hz = 900.0\n\n[[",
            "recorder",
            15,
            "no low-pass of either channel",
        ),
        ("$", "[channel.recorder]\nlow_pass_hz = 900.0\n", "channel.0.recorder", 22, "changes the mass"),
        ("$", "tip_mass_kg = 0.1\n", "channel.0.tip_mass_kg", 22, "calibrate the hammer"),
    ],
)
def test_what_does_not_go_with_a_hammer_is_named_with_its_row(
    folder: Path, pattern: str, text: str, column: str, row: int, words: str
) -> None:
    settings = folder / "dataset.toml"
    before = settings.read_text()
    settings.write_text(before + text if pattern == "$" else re.sub(pattern, text, before, count=1))
    with pytest.raises(InputError) as error:
        read_dataset(folder)
    problem = next(problem for problem in error.value.problems if problem.code == "hammer-unfit")
    assert (problem.file, problem.column, problem.row) == ("dataset.toml", column, row)
    assert words in str(problem)


def test_all_of_it_is_refused_at_once(folder: Path) -> None:
    changed(folder, r"\[signal\]", '[signal]\ngravity = "drop"')
    changed(folder, '"acceleration"', '"deceleration"')
    with pytest.raises(InputError) as error:
        read_dataset(folder)
    assert {problem.column for problem in error.value.problems} == {"signal.quantity", "signal.gravity"}


def test_no_gravity_may_be_said(folder: Path) -> None:
    assert read_dataset(changed(folder, r"\[signal\]", '[signal]\ngravity = "none"')).tapped


@pytest.mark.parametrize(("sd", "place"), [(2.0, "hammer"), (1.5, "base")])
def test_a_mass_may_be_a_guess_beside_a_hammer_alone(folder: Path, sd: float, place: str) -> None:
    changed(folder, "relative_mass_sd = 1.0", f"relative_mass_sd = {sd}")
    if place != "hammer":
        changed(folder, '"hammer"', f'"{place}"')
    with pytest.raises(InputError) as error:
        read_dataset(folder)
    (problem,) = (one for one in error.value.problems if one.column == "uncertainty.relative_mass_sd")
    assert f"a fraction below {2 if place == 'hammer' else 0.5:g}" in problem.expected


@pytest.mark.parametrize(
    ("spoil", "code", "words"),
    [
        (lambda text: text + "scale = -1.0\n", "channel-unfit", "negative scale under [[channel]]"),
        (lambda text: text.replace("[signal]", "[signal]\nscale = -1.0"), "channel-unfit", "under [signal]"),
        (lambda text: text.replace("[signal]", "[signal]\ncrop = [0.0098, 1.0]"), "channel-unfit", "before"),
        (lambda text: text + "time_offset_s = 9.0\n", "channel-unfit", "0 of its samples"),
        (lambda text: text + "scale = 1e-300\noffset = 1.0\n", "constant-signal", "changes"),
    ],
)
def test_recordings_that_are_of_no_tap_are_refused(
    folder: Path, spoil: Callable[[str], str], code: str, words: str
) -> None:
    settings = folder / "dataset.toml"
    settings.write_text(spoil(settings.read_text()))
    with pytest.raises(InputError) as error:
        read_dataset(folder)
    assert {problem.code for problem in error.value.problems} == {code}
    assert words in str(error.value)


def test_noise_of_a_tenth_of_the_force_spoils_no_tap(folder: Path) -> None:
    table = pd.read_csv(folder / "traces.csv")
    noise = np.random.default_rng(0).normal(0, 0.1 * table["force_N"].max(), len(table))
    table.assign(force_N=table["force_N"] + noise).to_csv(folder / "traces.csv", index=False)
    assert read_dataset(folder).tapped


def test_both_sensors_the_wrong_way_round_are_told_at_once(folder: Path) -> None:
    settings = folder / "dataset.toml"
    settings.write_text(settings.read_text().replace("[signal]", "[signal]\nscale = -1.0") + "scale = -1.0\n")
    with pytest.raises(InputError) as error:
        read_dataset(folder)
    remedies = {problem.remedy.partition(":")[0].partition(" if")[0] for problem in error.value.problems}
    assert remedies == {"Write a negative scale under [[channel]]", "Write a negative scale under [signal]"}


def test_arrays_have_a_hammer_as_a_folder_has(tmp_path: Path) -> None:
    campaign = simulate(TAPS)
    impacts = campaign.impacts.drop(columns="velocity_m_s")
    hammer = {"quantity": "force", "place": "hammer", "unit": "N", "value_column": "force_N"}
    given: dict[str, Any] = {
        "quantity": "acceleration",
        "unit": "m/s^2",
        "uncertainty": {"relative_mass_sd": 1.0},
    }
    data = bt.dataset(impacts, campaign.traces(), **given, channels=[{"name": "hammer"} | hammer])
    assert data.tapped
    again = read_dataset(data.write(tmp_path / "written"))
    np.testing.assert_allclose(again.traces[1].value, data.traces[1].value, rtol=1e-12)
    with pytest.raises(InputError) as error:
        bt.dataset(
            impacts, campaign.traces(), **given, channels={"hammer": hammer}, gravity="drop", headform=True
        )
    assert [(problem.column, problem.code) for problem in error.value.problems] == [
        ("gravity", "hammer-unfit"),
        ("headform", "hammer-unfit"),
    ]
