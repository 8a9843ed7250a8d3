"""Columns that have the number of a run in their names: one run a file, or several in one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset.formats.channel import unit_in_name
from bayestissue.recordings.intake import choices_of
from bayestissue.studies.init import prepare, write
from dataset_bench import deceleration

MASSES = (0.5, 0.7, 0.9)
SHARED = {"subject": "s", "velocity_m_s": "1.2"}
NAMED = {
    "behind": "{name} Run #{run}",
    "in front": "Run {run}: {name}",
}


def run_of(run: int, how: str) -> dict[str, np.ndarray]:
    """A run with a clock and a mass of its own."""
    time, value = deceleration(MASSES[run - 1], 1.2)
    columns = {
        "Time (s)": (1 + 0.01 * run) * time,
        "Acceleration (m/s²)": value,
        "Force (N)": MASSES[run - 1] * value,
    }
    return {NAMED[how].format(name=name, run=run): values for name, values in columns.items()}


def recorded(folder: Path, *tables: dict[str, np.ndarray]) -> Path:
    folder.mkdir()
    for number, table in enumerate(tables, 1):
        pd.DataFrame(table).to_csv(folder / f"{number}.csv", index=False)
    return folder


@pytest.mark.parametrize("how", NAMED)
def test_files_of_one_run_each_have_the_same_channels(how: str, tmp_path: Path) -> None:
    folder = recorded(tmp_path / "recorded", *(run_of(run, how) for run in (1, 2, 3)))
    intake = prepare(folder, choices_of(quantity="deceleration", given=SHARED | {"mass_kg": "0.7"}))
    assert list(intake.recordings.candidates()) == ["Time (s)", "Acceleration (m/s²)", "Force (N)"]
    assert not intake.questions
    data = write(intake, tmp_path / "made").dataset
    for run, (trace, force) in enumerate(zip(data.traces, data.further[0], strict=True), 1):
        expected = list(run_of(run, how).values())
        np.testing.assert_allclose([trace.time_s, trace.value, force.value], expected, rtol=1e-12)
        np.testing.assert_array_equal(force.time_s, trace.time_s)


@pytest.mark.parametrize("how", NAMED)
@pytest.mark.parametrize("run", [1, 3])
def test_a_run_of_several_in_a_file_has_its_own_time_and_unit(run: int, how: str, tmp_path: Path) -> None:
    columns = {name: values for number in (1, 2, 3) for name, values in run_of(number, how).items()}
    folder = recorded(tmp_path / "recorded", columns)
    time, acceleration, force = run_of(run, how)
    said: dict[str, Any] = {"quantity": "deceleration", "given": SHARED | {"mass_kg": "0.7"}}
    chosen = choices_of(channel=acceleration, force={"value_column": force, "place": "impactor"}, **said)
    data = write(prepare(folder, chosen), tmp_path / "made").dataset
    (trace,), (beside,) = data.traces, data.further[0]
    np.testing.assert_allclose(
        [trace.time_s, trace.value], [columns[time], columns[acceleration]], rtol=1e-12
    )
    np.testing.assert_array_equal(beside.time_s, trace.time_s)
    assert unit_in_name(acceleration) == "m/s²"
