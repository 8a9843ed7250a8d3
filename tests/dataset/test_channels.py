"""A further channel of the same impacts: read, checked, written back, compared with the first."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import butter, lfilter

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset, write_dataset
from bayestissue.recordings.dataset.write import settings_text
from bayestissue.studies.checking import check
from cases import cases
from command_line import bayestissue
from dataset_bench import MASSES, NAMES, RATE, SETTINGS, Lab, deceleration, tables

TIP, RATIO = 0.1, 1.1
CELL = {
    "name": "load cell",
    "quantity": "force",
    "place": "impactor",
    "unit": "N",
    "value_column": "force_N",
    "relative_gain_sd": 0.01,
    "tip_mass_kg": TIP,
}


def bench(
    folder: Path, *, factor: float = 1.0, zero: float = 0.3, noise: float = 0.02, **channel: Any
) -> Path:
    """The bench with a load cell that reads `RATIO` times the force behind its tip, in the same table."""
    impacts, traces = tables()
    behind = traces["impact"].map(dict(zip(NAMES, MASSES, strict=True))).astype(float) - TIP
    random = np.random.default_rng(0).normal(0, noise, len(traces))
    traces["force_N"] = factor * (RATIO * behind * traces["value"] + zero + random)
    settings = SETTINGS | {"channel": [CELL]}
    write_dataset(folder, settings=settings, impacts=impacts, traces=traces, trace_file="traces.csv")
    stated = {key: value for key, value in (CELL | channel).items() if value != ""}
    (folder / "dataset.toml").write_text(settings_text(SETTINGS | {"channel": [stated]}))
    return folder


def test_units_scale_and_clock_of_the_channel_are_its_own(tmp_path: Path) -> None:
    plain = read_dataset(bench(tmp_path / "plain")).further[0][0]
    other = bench(tmp_path / "other", factor=-1e-3, unit="kN", scale=-1.0, time_offset_s=0.001)
    trace = read_dataset(other).further[0][0]
    np.testing.assert_allclose(trace.value, plain.value, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(trace.time_s, plain.time_s + 0.001)


def test_a_file_of_its_own_may_have_another_rate(tmp_path: Path) -> None:
    folder = bench(tmp_path / "bench")
    data = read_dataset(folder)
    bench(folder, value_column="", file="force.csv")
    table = pd.read_csv(folder / "traces.csv").drop(columns="value").rename(columns={"force_N": "value"})
    table.iloc[::4].to_csv(folder / "force.csv", index=False)
    slow = read_dataset(folder)
    assert np.diff(slow.further[0][0].time_s).mean() == pytest.approx(4 / RATE)
    assert slow.input_hash != data.input_hash
    assert check(slow).quality["force_ratio"].to_numpy() == pytest.approx(RATIO, rel=0.005)


@pytest.mark.parametrize("case", cases(__file__, "refused"))
def test_what_is_wrong_with_a_channel_is_refused_by_its_key_or_code(
    tmp_path: Path, case: dict[str, Any]
) -> None:
    with pytest.raises(InputError) as refused:
        read_dataset(bench(tmp_path / "bench", factor=case.get("factor", 1.0), **case.get("channel", {})))
    assert case["says"] in str(refused.value)
    if "row" in case:
        assert [problem.row for problem in refused.value.problems] == [case["row"]]
    else:
        assert {problem.code for problem in refused.value.problems} == {case["code"]}


def test_a_cell_of_the_channel_that_is_no_number_leaves_its_impact_out(tmp_path: Path) -> None:
    folder = bench(tmp_path / "bench")
    Lab(folder).cell("traces.csv", 2, "force_N", "OVER")
    with pytest.raises(InputError, match=r"row 2, column force_N, impact a: found \"OVER\""):
        read_dataset(folder)
    data = read_dataset(folder, skip_bad=True)
    assert data.impacts["impact"].tolist() == list(NAMES[1:])
    assert len(data.further[0]) == len(NAMES) - 1


def warned(found: bt.Check, code: str) -> list[str]:
    return [str(problem) for problem in found.warnings if problem.code == code]


def test_check_compares_force_with_mass_times_deceleration(tmp_path: Path) -> None:
    found = check(bench(tmp_path / "bench"))
    assert found.force is not None
    ratio, ratio_sd = found.quality["force_ratio"], found.quality["force_ratio_sd"]
    assert (np.abs(ratio - RATIO) < 4 * ratio_sd).all()
    # A zero of the load cell is no part of the ratio.
    assert ratio_sd.max() < 0.002
    assert found.force.declared_sd == pytest.approx(np.hypot(0.01, 0.01))
    assert found.force.contradicts
    assert not found.force.lags
    (warning,) = warned(found, "channels-disagree")
    assert "10 % more than mass_kg says" in warning


SIZES = np.array([1.0, 1.2, 0.8, 1.0, 1.2, 0.8, 1.0, 1.2])
HALF = np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.5, 1.5])
TIME = np.arange(600) / RATE - 0.01


def eight(
    change: Callable[[np.ndarray, np.ndarray], np.ndarray], late_s: float = 0.0, **said: Any
) -> bt.Dataset:
    """Eight impacts with three masses, and of their forces [impact, sample] what ``change`` makes of them."""
    random = np.random.default_rng(3)
    slowing = np.array([deceleration(mass, size)[1] for mass, size in zip(HALF, SIZES, strict=True)])
    slowing = np.pad(slowing, ((0, 0), (50, 150))) + random.normal(0, 0.05, (8, 600))
    forces = change(HALF[:, None] * slowing, slowing) + random.normal(0, 0.05, slowing.shape)
    names = [f"i{number}" for number in range(8)]
    rows = {"impact": names, "subject": "s", "mass_kg": HALF, "velocity_m_s": SIZES}
    traces = {name: (TIME, each) for name, each in zip(names, slowing, strict=True)}
    cell = {"quantity": "force", "place": "impactor", "unit": "N", "relative_gain_sd": 0.02}
    cell["traces"] = {name: (TIME + late_s, each) for name, each in zip(names, forces, strict=True)}
    return bt.dataset(rows, traces, quantity="deceleration", unit="m/s^2", channels={"cell": cell | said})


def filtered(corner: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda force, _: lfilter(*butter(2, 2 * corner / RATE), force, axis=1)


@pytest.mark.parametrize(
    ("change", "late_s", "value"),
    [
        (lambda force, slowing: np.roll(force, 1, axis=0), 0.0, "each known to"),
        (lambda force, slowing: slowing, 0.0, "0.667 to 2, each known to"),
        (lambda force, slowing: force * np.where(HALF == 1.0, 1.1, 1.0)[:, None], 0.0, "i3, i4, i5 apart"),
        (lambda force, _: force, 0.001, "1 ms behind the deceleration: correct time_offset_s by -0.001 s"),
        (lambda force, _: force, -0.004, "4 ms ahead of the deceleration: correct time_offset_s by 0.004 s"),
        (filtered(300.0), 0.0, "it went through a low-pass of"),
        (lambda force, _: force + 600 * (TIME + 0.01), 0.0, "it drifts while it acts"),
        (lambda force, _: force - 30 * np.cumsum(force, axis=1) / RATE, 0.0, "it drifts while it acts"),
    ],
    ids=["neighbour", "copy", "gain", "1 ms", "-4 ms", "filtered", "drift", "charge"],
)
def test_check_names_what_is_wrong_with_an_impossible_force(
    change: Callable[[np.ndarray, np.ndarray], np.ndarray], late_s: float, value: str
) -> None:
    found = check(eight(change, late_s))
    told = warned(found, "channels-disagree")
    assert any(value in words for words in told)
    assert found.verdict != "fine"
    assert not any("correct time_offset_s" in words for words in told) or "time_offset_s" in value


@pytest.mark.parametrize("place", ["impactor", "base"])
def test_check_calls_a_possible_force_fine(place: str) -> None:
    def on_tissue(force: np.ndarray, slowing: np.ndarray) -> np.ndarray:
        """That moves along, 0.1 kg of it, which a force below it shows."""
        return force + 0.1 * slowing * (place == "base")

    found = check(eight(on_tissue, place=place, relative_gain_sd=0.1))
    assert warned(found, "channels-disagree") == []


def test_the_command_and_its_page_show_both(tmp_path: Path) -> None:
    folder = bench(tmp_path / "bench")
    outcome = bayestissue("check", folder, "--out", tmp_path / "checked")
    assert outcome.status == 0
    assert "of (M - m) a" in outcome.out
    page = (tmp_path / "checked" / "check.html").read_text()
    assert "Force against M a" in page
    assert "recorded force" in page


def pressed(push_N: float, gravity: float = 0.0, **uncertainty: float) -> tuple[bt.Dataset, float]:
    """A mass on a spring, its displacement and the spring's force; ``push_N`` acts on the mass besides.

    M x'' = P + M g - K x has x = s (1 - cos w t) + V / w sin w t, s = P / K + g / w^2. The greatest depth is
    at tan w t_p = -V / (w s). Returned with the ratio of the spring's impulse until then to M (V + g t_p).
    """
    M, K, V, rate = 4.0, 40_000.0, 0.4, 2000.0
    w = np.sqrt(K / M)
    rest = push_N / K + gravity / w**2
    to_peak = (np.pi - np.arctan(V / (w * rest))) / w if rest else np.pi / 2 / w
    t = np.arange(-80, 80) / rate
    moved = rest * (1 - np.cos(w * t)) + V / w * np.sin(w * t)
    x = np.where(t < 0, V * t + gravity * t**2 / 2, moved)
    traces = pd.DataFrame({"impact": "a", "time_s": t, "value": x, "force_N": K * np.maximum(x, 0.0)})
    impacts = pd.DataFrame([{"impact": "a", "subject": "s", "trial": "t", "mass_kg": M, "velocity_m_s": V}])
    plate = {"quantity": "force", "place": "base", "unit": "N", "value_column": "force_N"}
    said = {"gravity": gravity or "none", "uncertainty": uncertainty, "channels": {"plate": plate}}
    data = bt.dataset(impacts, traces, quantity="displacement", unit="m", **said)
    return data, 1 + push_N * to_peak / (M * (V + gravity * to_peak))


@pytest.mark.parametrize(("push_N", "gravity"), [(0.0, 0.0), (0.0, 9.81), (150.0, 9.81)])
def test_beside_a_displacement_impulses_are_compared(push_N: float, gravity: float) -> None:
    data, ratio = pressed(push_N, gravity, relative_mass_sd=0.02)
    found = check(data)
    assert found.force is not None
    # The greatest depth is found between samples, to a hundredth of the time to it, where v is 0.
    assert found.force.common[0] == pytest.approx(ratio, rel=0.005)
    assert found.force.contradicts == bool(push_N)
    told = warned(found, "impulse-disagrees")
    assert bool(told) == bool(push_N)
    if push_N:
        assert "a free mass has to hit" in told[0]
        assert f"{1 - 1 / ratio:.0%} of the impulse is of something else" in found.force.words
    assert "Impulse against M V" in found.page()


def test_the_command_says_it_of_a_displacement_too(tmp_path: Path) -> None:
    data, ratio = pressed(150.0, relative_mass_sd=0.02)
    data.write(tmp_path / "pressed")
    outcome = bayestissue("check", tmp_path / "pressed", "--json")
    assert outcome.status == 0
    # Valid JSON has no word for a lag that there is none of.
    said = json.loads(outcome.out, parse_constant=pytest.fail)["force"]
    assert said["ratio"] == pytest.approx(ratio, rel=0.005)
    assert said["contradicts"]
    assert "lag_s" not in said


def from_arrays(**said: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """The bench as arrays: the first channel's arguments, and what is said of the force."""
    impacts, traces = tables()
    mass = traces["impact"].map(dict(zip(NAMES, MASSES, strict=True))).astype(float)
    traces["force_N"] = mass * traces["value"] + np.random.default_rng(0).normal(0, 0.02, len(traces))
    given = {"impacts": impacts, "traces": traces, "quantity": "deceleration", "unit": "m/s^2"}
    return given, {"quantity": "force", "place": "base", "unit": "N", **said}


def pairs(table: pd.DataFrame, column: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By the impact's name times and values."""
    parts = table.groupby("impact", observed=True)
    return {str(name): (part["time_s"].to_numpy(), part[column].to_numpy()) for name, part in parts}


def test_arrays_have_a_channel_as_a_folder_has(tmp_path: Path) -> None:
    given, said = from_arrays(relative_gain_sd=0.01)
    table = given["traces"]
    beside = bt.dataset(**given, channels={"cell": said | {"value_column": "force_N"}})
    own = bt.dataset(**given, channels={"cell": said | {"traces": pairs(table, "force_N")}})
    given["traces"] = pairs(table, "value")
    named = {"name": "cell", **said, "traces": table, "value_column": "force_N"}
    apart = bt.dataset(**given, channels=[named])
    for data in (beside, own, apart, bt.read_dataset(beside.write(tmp_path / "written"))):
        (channel,) = data.channels
        assert (channel.name, channel.place, channel.relative_gain_sd) == ("cell", "base", 0.01)
        for one, other in zip(data.further[0], beside.further[0], strict=True):
            np.testing.assert_allclose(one.value, other.value, rtol=1e-12)
    assert check(own).quality["force_ratio"].to_numpy() == pytest.approx(1, rel=0.005)
    np.testing.assert_array_equal(own.select([2]).further[0][0].value, own.further[0][2].value)
    assert own.input_hash != bt.dataset(**given).input_hash


@pytest.mark.parametrize(("channels", "words"), cases(__file__, "of_arrays"))
def test_what_is_wrong_with_a_channel_of_arrays_is_said(channels: Any, words: str) -> None:
    given, said = from_arrays()
    given["traces"] = pairs(given["traces"], "value")
    if isinstance(channels, dict) and isinstance(channels["cell"], dict):
        channels = {"cell": said | channels["cell"]}
        if words.startswith("recordings"):
            channels["cell"]["value_column"] = "force_N"
    with pytest.raises(InputError) as refused:
        bt.dataset(**given, channels=channels)
    assert words in str(refused.value)
