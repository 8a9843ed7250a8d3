from __future__ import annotations

import json
import time
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
from dataset_bench import NAMES, RATE, SETTINGS, Lab, tables


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
    pd.testing.assert_frame_equal(dataset.impacts, impacts)
    assert (dataset.name, dataset.quantity, dataset.left_out) == ("bench", "deceleration", ())
    assert dataset.uncertainty.velocity_sd_m_s == 0.005
    assert dataset.warnings == ()
    for impact, trace in zip(NAMES, dataset.traces, strict=True):
        mine = traces[traces["impact"] == impact]
        np.testing.assert_array_equal(trace.time_s, mine["time_s"])
        np.testing.assert_array_equal(trace.value, mine["value"])


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


def test_acceleration_is_the_negative(lab: Lab) -> None:
    lab.replace("dataset.toml", 'quantity = "deceleration"', 'quantity = "acceleration"')
    lab.replace("dataset.toml", 'unit = "m/s^2"', 'unit = "m/s^2"\nscale = -1')
    assert read_dataset(lab.folder).quantity == "acceleration"


def test_spreadsheet_habits_are_forgiven(lab: Lab) -> None:
    text = lab.text("impacts.csv").replace("\n", "\r\n").replace("a,s1", " a , s1 ")
    lab.path("impacts.csv").write_bytes(b"\xef\xbb\xbf" + text.encode() + b",,,,,,\r\n\r\n")
    lab.path("traces.csv").write_bytes(b"\xef\xbb\xbf" + lab.path("traces.csv").read_bytes() + b"\n\n")
    assert tuple(read_dataset(lab.folder).impacts["impact"]) == NAMES


def test_skip_bad_leaves_out_what_is_bad(lab: Lab, tmp_path: Path) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "0")
    lab.value("c", "-v")
    dataset = read_dataset(lab.folder, skip_bad=True)
    assert tuple(dataset.impacts["impact"]) == ("b", "d")
    assert len(dataset.traces) == 2
    assert {problem.impact for problem in dataset.left_out} == {"a", "c"}
    outcome = bayestissue("check", lab.folder, "--skip-bad", "--out", tmp_path / "quality")
    assert outcome.status == 0
    assert "impact a" in outcome.out
    problems = pd.read_csv(tmp_path / "quality" / "problems.csv")
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


def test_recording_may_begin_at_contact_and_end_at_zero_velocity(lab: Lab) -> None:
    table = pd.read_csv(lab.path("traces.csv"))
    velocity = table["impact"].map(tables()[0].set_index("impact")["velocity_m_s"])
    lost = table.groupby("impact")["value"].cumsum() / RATE
    table[(table["time_s"] >= 0) & (lost <= velocity)].to_csv(lab.path("traces.csv"), index=False)
    assert len(read_dataset(lab.folder).traces) == len(NAMES)


def test_heel_strikes_pass(heel_strikes: Path) -> None:
    dataset = read_dataset(heel_strikes)
    assert len(dataset.traces) == len(dataset.impacts) == 216
    assert dataset.impacts["body_mass_kg"].between(40, 120).all()
    assert bayestissue("check", heel_strikes, "--quiet") == Outcome(0, "", "")


def test_json_lists_what_the_table_shows(lab: Lab) -> None:
    outcome = bayestissue("check", lab.folder, "--json")
    shown = json.loads(outcome.out)
    assert (outcome.status, shown["verdict"], shown["impacts"]) == (0, "fine", 4)
    assert [row["impact"] for row in shown["quality"]] == list(NAMES)


def test_what_is_warned_of_is_not_called_fine(lab: Lab) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "500")
    shown = json.loads(bayestissue("check", lab.folder, "--json").out)
    assert shown["warnings"]
    assert shown["verdict"] == "no errors, 1 warning"


def test_errors_as_json(lab: Lab) -> None:
    lab.cell("impacts.csv", 2, "mass_kg", "0")
    outcome = bayestissue("check", lab.folder, "--json")
    (problem,) = json.loads(outcome.err)["problems"]
    assert (outcome.status, problem["row"], problem["column"]) == (2, 2, "mass_kg")


@pytest.mark.slow
def test_check_writes_quality_figures(lab: Lab, tmp_path: Path) -> None:
    out = tmp_path / "quality"
    assert bayestissue("check", lab.folder, "--out", out).status == 0
    written = {".bayestissue.json", "quality.csv", "problems.csv", "check.html"}
    assert {path.name for path in out.iterdir()} == written
    quality = pd.read_csv(out / "quality.csv")
    # Noise of 0.05 m/s² from 50 quiet samples: its standard error is 10 %, so 40 % is four of them.
    np.testing.assert_allclose(quality["noise_sd_m_s2"], 0.05, rtol=0.4)
    np.testing.assert_allclose(quality["sampling_rate_hz"], 1e4, rtol=1e-6)
    assert (quality["contact_time_s"].abs() < 1e-4).all()
    page = (out / "check.html").read_text()
    assert "bench: fine" in page
    assert page.count('class="chart"') == 1


@pytest.mark.slow
def test_ten_thousand_impacts_load_in_seconds(tmp_path: Path) -> None:
    count, samples = 10_000, 200
    when = np.arange(samples) * 2e-4 - 2e-3
    value = np.where(when > 0, 40 * np.sin(np.pi * np.maximum(when, 0) / 0.04), 0.0).round(4)
    names = [f"i{index:05d}" for index in range(count)]
    impacts = pd.DataFrame({"impact": names, "subject": "s", "mass_kg": 1.0, "velocity_m_s": 0.5})
    traces = pd.DataFrame(
        {
            "impact": pd.Categorical.from_codes(np.repeat(np.arange(count), samples), names),
            "time_s": np.tile(when.round(9), count),
            "value": np.tile(value, count).astype(np.float32),
        }
    )
    write_dataset(tmp_path, settings=SETTINGS, impacts=impacts, traces=traces, trace_file="traces.parquet")
    begin = time.process_time()
    dataset = read_dataset(tmp_path)
    # About 1 s of processor time; a loop over samples would take minutes.
    assert time.process_time() - begin < 20
    assert len(dataset.traces) == count


@pytest.mark.slow
def test_with_too_many_impacts_the_page_shows_the_most_suspicious(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bayestissue.reports.pages.recordings_pages.MOST_CHECK_PANELS", 2)
    lab.value("c", "v + np.random.default_rng(0).normal(0, 1, 400)")
    assert bayestissue("check", lab.folder, "--out", tmp_path / "quality").status == 0
    page = (tmp_path / "quality" / "check.html").read_text()
    assert "The 2 most suspicious of 4 impacts" in page
    assert ">c</td>" in page
    assert len(pd.read_csv(tmp_path / "quality" / "quality.csv")) == 4


def test_words_of_a_study_and_a_site_of_published_values_are_kept(lab: Lab, tmp_path: Path) -> None:
    lab.replace("dataset.toml", "name =", 'site = "prosthetic heel"\nname =')
    lab.append("dataset.toml", '\n[words]\nsubject = "pad"\nimpact = "drop"\n')
    dataset = read_dataset(lab.folder)
    for found in (dataset, read_dataset(dataset.write(tmp_path / "again"))):
        assert found.words == {"subject": "pad", "impact": "drop"}
        assert found.site == "prosthetic heel"
