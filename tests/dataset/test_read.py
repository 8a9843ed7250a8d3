from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset, write_dataset
from cases import cases
from command_line import Outcome, bayestissue
from country import GERMAN, Country
from dataset_bench import NAMES, SETTINGS, Lab, tables
from recorder_files import xlsx


def require_bench(dataset: bt.Dataset) -> None:
    impacts, traces = tables()
    pd.testing.assert_frame_equal(dataset.impacts, impacts)
    for impact, trace in zip(NAMES, dataset.traces, strict=True):
        mine = traces[traces["impact"] == impact]
        np.testing.assert_array_equal(trace.time_s, mine["time_s"])
        np.testing.assert_array_equal(trace.value, mine["value"])


@pytest.mark.parametrize("trace_file", ["traces.csv", "traces.csv.gz", "traces.parquet"])
def test_what_is_written_is_read_and_the_same_content_has_the_same_hash(
    trace_file: str, tmp_path: Path
) -> None:
    impacts, traces = tables()
    content = {"settings": SETTINGS, "impacts": impacts, "traces": traces, "trace_file": trace_file}
    for folder in (tmp_path / "one", tmp_path / "two"):
        write_dataset(folder, **content)
    dataset = bt.read_dataset(tmp_path / "one")
    assert dataset.input_hash == bt.read_dataset(tmp_path / "two").input_hash
    require_bench(dataset)
    assert (dataset.name, dataset.quantity, dataset.left_out) == ("bench", "deceleration", ())
    assert dataset.uncertainty.velocity_sd_m_s == 0.005
    assert dataset.warnings == ()


def test_texts_of_another_country_are_read(lab: Lab) -> None:
    impacts, traces = tables()
    recorder = Country("utf-16", "\t", ",", ("Prüfstand",))
    rows = [[name, recorder.number(t, 9), recorder.number(v, 4)] for name, t, v in traces.to_numpy().tolist()]
    lab.path("traces.csv").write_bytes(recorder.table(list(traces), rows))
    facts = impacts.astype(str).replace(r"\.", ",", regex=True)
    lab.path("impacts.csv").write_bytes(GERMAN.table(list(facts), facts.to_numpy().tolist()))
    require_bench(read_dataset(lab.folder))
    rows[9][2] = "kaputt"
    lab.path("traces.csv").write_bytes(recorder.table(list(traces), rows))
    with pytest.raises(InputError, match=r"traces\.csv, row 12, column value, impact a: found \"kaputt\""):
        read_dataset(lab.folder)


def test_workbooks_stand_in_for_both_tables(lab: Lab) -> None:
    impacts, samples = ([list(table), *table.to_numpy(object).tolist()] for table in tables())
    xlsx(lab.path("impacts.xlsx"), impacts)
    with pytest.raises(InputError, match=r'impacts\.xlsx: found "both"'):
        read_dataset(lab.folder)
    lab.remove("impacts.csv")
    lab.remove("traces.csv")
    xlsx(lab.path("traces.xlsx"), samples)
    require_bench(read_dataset(lab.folder))
    impacts[2][impacts[0].index("mass_kg")] = -0.5
    xlsx(lab.path("impacts.xlsx"), impacts)
    with pytest.raises(InputError, match=r"impacts\.xlsx, row 3, column mass_kg"):
        read_dataset(lab.folder)


def test_order_of_the_table_does_not_matter_and_rows_are_named_as_in_the_file(lab: Lab) -> None:
    table = pd.read_csv(lab.path("traces.csv"))
    # Impacts interleaved sample by sample, the samples of each still in their order.
    mixed = table.assign(turn=table.groupby("impact").cumcount()).sort_values(["turn", "impact"])
    before = read_dataset(lab.folder)
    mixed.drop(columns="turn").to_csv(lab.path("traces.csv"), index=False)
    for old, new in zip(before.traces, read_dataset(lab.folder).traces, strict=True):
        np.testing.assert_array_equal(old.value, new.value)
    lab.cell("traces.csv", 44, "value", "?")
    with pytest.raises(InputError) as refused:
        read_dataset(lab.folder)
    (problem,) = refused.value.problems
    assert (problem.row, problem.value, problem.impact) == (44, "?", "c")


def test_units_scale_and_offset(lab: Lab) -> None:
    lab.replace("dataset.toml", 'unit = "m/s^2"', 'unit = "mm/s^2"\nscale = 1000\noffset = 500')
    _, traces = tables()
    value = read_dataset(lab.folder).traces[0].value
    # One rounding each of a product, a sum and a quotient near 50 m/s².
    np.testing.assert_allclose(value, traces["value"][: value.size] + 0.5, rtol=0, atol=3e-14)


def test_a_crop_is_in_the_unit_of_time_and_what_lies_outside_may_be_spoilt(lab: Lab) -> None:
    _, traces = tables()
    traces.assign(time_s=1e3 * traces["time_s"]).to_csv(lab.path("traces.csv"), index=False)
    lab.cell("traces.csv", 3, "value", "saturated")
    lab.replace("dataset.toml", "[signal]", '[signal]\ntime_unit = "ms"\ncrop = [1.0, 30.0]')
    for impact, trace in zip(NAMES, read_dataset(lab.folder).traces, strict=True):
        inside = traces[(traces["impact"] == impact) & traces["time_s"].between(0.001, 0.03)]
        # Two conversions of a unit: two roundings.
        np.testing.assert_allclose(trace.time_s, inside["time_s"], rtol=4e-16)
        np.testing.assert_array_equal(trace.value, inside["value"])
    lab.cell("traces.csv", 100, "value", "lost")
    with pytest.raises(InputError, match=r"row 100, column value, impact a: found \"lost\""):
        read_dataset(lab.folder)


def test_spreadsheet_habits_are_forgiven(lab: Lab) -> None:
    text = lab.text("impacts.csv").replace("\n", "\r\n").replace("a,s1", " a , s1 ")
    lab.path("impacts.csv").write_bytes(b"\xef\xbb\xbf" + text.encode() + b",,,,,,\r\n\r\n")
    lab.path("traces.csv").write_bytes(b"\xef\xbb\xbf" + lab.path("traces.csv").read_bytes() + b"\n\n")
    assert tuple(read_dataset(lab.folder).impacts["impact"]) == NAMES


def test_skip_bad_leaves_out_what_is_bad(lab: Lab) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "0")
    lab.value("c", "-v")
    dataset = read_dataset(lab.folder, skip_bad=True)
    assert tuple(dataset.impacts["impact"]) == ("b", "d")
    assert len(dataset.traces) == 2
    assert {problem.impact for problem in dataset.left_out} == {"a", "c"}
    problems = bt.check(dataset).problems
    assert set(problems.loc[problems["severity"] == "left out", "impact"]) == {"a", "c"}


def test_skip_bad_does_not_skip_what_concerns_all(lab: Lab) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "0")
    lab.cell("impacts.csv", 3, "impact", "")
    with pytest.raises(InputError):
        read_dataset(lab.folder, skip_bad=True)


def test_skip_bad_with_nothing_left(lab: Lab) -> None:
    lab.column("mass_kg", 0)
    with pytest.raises(InputError, match="none left"):
        read_dataset(lab.folder, skip_bad=True)


@pytest.mark.parametrize(("column", "value", "says"), cases(__file__, "odd"))
def test_odd_cells_are_warnings(column: str, value: str, says: str, lab: Lab) -> None:
    lab.cell("impacts.csv", 2, column, value)
    dataset = read_dataset(lab.folder, skip_bad=True)
    said = [*dataset.warnings, *dataset.left_out]
    assert any(says in str(problem) and problem.row == 2 for problem in said) or column == "velocity_m_s"


def test_energy_that_contradicts_mass_and_velocity(lab: Lab) -> None:
    impacts, _ = tables()
    lab.column("energy_J", impacts["mass_kg"] * impacts["velocity_m_s"] ** 2 * np.array([0.5, 0.5, 1.0, 0.5]))
    (warning,) = read_dataset(lab.folder).warnings
    assert (warning.row, warning.column, warning.impact) == (4, "energy_J", "c")


@pytest.mark.parametrize("case", cases(__file__, "sound"))
def test_nothing_is_left_out_for_what_a_recorder_may_do(case: dict[str, Any], lab: Lab) -> None:
    lab.spoil(case)
    assert read_dataset(lab.folder).left_out == ()


def test_heel_strikes_pass(heel_strikes: Path) -> None:
    dataset = read_dataset(heel_strikes)
    assert len(dataset.traces) == len(dataset.impacts) == 216
    assert dataset.impacts["body_mass_kg"].between(40, 120).all()
    assert bayestissue("check", heel_strikes, "--quiet") == Outcome(0, "", "")


def test_errors_as_json(lab: Lab) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "0")
    outcome = bayestissue("check", lab.folder, "--json")
    (problem,) = json.loads(outcome.err)["problems"]
    assert (outcome.status, problem["row"], problem["column"]) == (2, 2, "mass_kg")
