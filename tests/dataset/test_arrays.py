"""Datasets from tables and arrays: what a folder of the same content gives, in the caller's words."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.recordings.dataset import Dataset
from cases import cases
from dataset_bench import SETTINGS, Lab, tables

GIVEN = SETTINGS["signal"] | {name: SETTINGS[name] for name in ("name", "description", "uncertainty")}


def require_equal(one: Dataset, other: Dataset) -> None:
    pd.testing.assert_frame_equal(one.impacts, other.impacts)
    for mine, theirs in zip(one.traces, other.traces, strict=True):
        np.testing.assert_array_equal(mine.time_s, theirs.time_s)
        np.testing.assert_array_equal(mine.value, theirs.value)
    for name in ("name", "description", "licence", "source", "site", "quantity", "uncertainty", "gravity"):
        assert getattr(one, name) == getattr(other, name)


def separate(impacts: pd.DataFrame, traces: pd.DataFrame) -> dict:
    groups = dict(list(traces.groupby("impact", observed=True)))
    return {name: (groups[name]["time_s"].to_numpy(), groups[name]["value"]) for name in impacts["impact"]}


def with_first(trace: object) -> dict:
    """The recordings one by one, of which the first is another."""
    return {"traces": separate(*tables()) | {tables()[0]["impact"][0]: trace}}


@pytest.mark.parametrize("form", ["long", "by name", "in order", "tables", "rows", "columns"])
def test_it_is_the_dataset_of_the_folder(lab: Lab, form):
    impacts, traces = tables()
    own = separate(impacts, traces)
    given = {
        "long": traces.sample(frac=1, random_state=1).sort_values("time_s"),
        "by name": own,
        "in order": list(own.values()),
        "rows": {name: np.stack([t, v]) for name, (t, v) in own.items()},
        "columns": {name: np.column_stack([t, v]) for name, (t, v) in own.items()},
        "tables": {name: pd.DataFrame({"time_s": t, "value": v}) for name, (t, v) in own.items()},
    }[form]
    made = bt.dataset(impacts, given, **GIVEN)
    require_equal(made, bt.read_dataset(lab.folder))
    assert made.folder is None


def test_it_is_written_and_read_back_equal_and_replaced_only_unchanged(tmp_path):
    impacts, traces = tables()
    impacts = impacts.assign(side=["left", 'the "other", right'] * 2)
    made = bt.dataset(impacts, traces, **GIVEN, licence="CC0", source="a lab", site="heel")
    folder = tmp_path / "written"
    assert made.write(folder) == folder
    require_equal(bt.read_dataset(folder), made)
    with pytest.raises(bt.InputError, match="not empty"):
        made.write(folder)
    made.write(folder, overwrite=True)
    (folder / "impacts.csv").write_text("changed")
    with pytest.raises(bt.InputError, match="changed since"):
        made.write(folder, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["written"]


@pytest.mark.parametrize("quantity", ["deceleration", "acceleration"])
def test_a_zero_at_rest_becomes_force_over_mass(tmp_path, quantity):
    impacts, traces = tables()
    sign = 1.0 if quantity == "deceleration" else -1.0
    force = traces.assign(value=sign * traces["value"])
    below = traces.assign(value=sign * (traces["value"] + 2.0))
    given = {**GIVEN, "quantity": quantity, "gravity": -2.0}
    made, at_rest = bt.dataset(impacts, force, **given), bt.dataset(impacts, below, **given, zero="rest")
    assert made.gravity == at_rest.gravity == -2.0
    for one, other in zip(made.traces, at_rest.traces, strict=True):
        np.testing.assert_allclose(one.value, other.value, atol=1e-12)
    require_equal(bt.read_dataset(at_rest.write(tmp_path / "written")), at_rest)


def test_a_height_of_fall_asks_how_the_impact_moves():
    impacts, traces = tables()
    impacts = impacts.assign(drop_height_cm=12.0)
    (warning,) = bt.dataset(impacts, traces, **GIVEN).warnings
    assert (warning.code, warning.column) == ("gravity", "gravity")
    assert not bt.dataset(impacts, traces, **GIVEN, gravity="none").warnings


def test_a_write_that_fails_leaves_nothing(tmp_path, monkeypatch):
    made = bt.dataset(*tables(), **GIVEN)
    monkeypatch.setattr("bayestissue.recordings.dataset.write._write_table", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        made.write(tmp_path / "written")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        *cases(__file__, "arguments"),
        ({"uncertainty": {"relative_mass_sd": np.float64(3.0)}}, "3 %, if that is meant, is 0.03"),
        ({"recorder": {1: 2}}, "column recorder.1"),
        ({"traces": tables()[1].drop(columns="value")}, 'a column "value"'),
        ({"impacts": tables()[0].drop(columns="mass_kg")}, 'a column "mass_kg"'),
        (with_first(([0.0, 1.0], [1.0])), "2 times and 1 values"),
        (with_first(np.zeros((3, 5))), "shape (3, 5)"),
        (with_first((np.arange(50) * 1e-4, np.zeros((50, 2)))), "shape (50, 2)"),
        (with_first((pd.date_range("2026-01-01", periods=50), np.zeros(50))), "datetime64"),
        (with_first((np.arange(50) * 1e-4, ["1"] * 49 + ["x"])), 'row 49, column value, impact a: found "x"'),
    ],
)
def test_arguments_that_are_wrong_are_named(change, words):
    impacts, traces = tables()
    given = {"impacts": impacts, "traces": traces, **GIVEN, **change}
    with pytest.raises(bt.InputError) as error:
        bt.dataset(given.pop("impacts"), given.pop("traces"), **given)
    assert words in str(error.value)


def test_names_may_be_numbers_and_values_of_other_units():
    impacts, traces = tables()
    number = {name: place for place, name in enumerate(impacts["impact"])}
    own = pd.DataFrame({"impact": traces["impact"].map(number).astype(float)})
    own = own.assign(ms=traces["time_s"] * 1e3, raw=-traces["value"] / 9.80665 / 2)
    said = {"quantity": "acceleration", "unit": "g", "time_unit": "ms", "scale": 2}
    numbered = impacts.assign(impact=range(len(impacts)), subject=np.arange(len(impacts)) // 2 + 0.0)
    made = bt.dataset(numbered, own, **said, time_column="ms", value_column="raw")
    expected = bt.dataset(impacts, traces, **GIVEN)
    assert made.impacts["impact"].tolist() == [str(place) for place in range(len(impacts))]
    assert made.impacts["subject"][1] == "0"
    np.testing.assert_allclose(made.traces[1].value, -expected.traces[1].value, rtol=1e-14, atol=1e-12)


def test_a_check_of_it_says_what_the_command_says(lab: Lab):
    found = bt.check(bt.dataset(*tables(), **GIVEN))
    assert found.verdict == bt.check(bt.read_dataset(lab.folder)).verdict
    assert len(found.quality) == len(tables()[0])
    # Noise of 0.05 m/s² from 50 quiet samples: its standard error is 10 %, so 40 % is four of them.
    np.testing.assert_allclose(found.quality["noise_sd_m_s2"], 0.05, rtol=0.4)
    np.testing.assert_allclose(found.quality["sampling_rate_hz"], 1e4, rtol=1e-6)
    assert found.verdict in repr(found)
    assert "<table>" in found._repr_html_()
    assert found.problems.columns[0] == "severity"
