"""Times as recorders and phones write them: clock times, coarse ones, and such beside a stated rate."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.clock_times import seconds
from bayestissue.recordings.dataset.recorders import contents_of
from bayestissue.recordings.dataset.source_files import Source
from recorder_files import Styled, xlsx

RATE, VELOCITY = 2000.0, 1.2
BEGIN = datetime(2020, 11, 11, 23, 59, 59, 950_000)


def recording() -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and decelerations (m/s²) of a fall on a spring of 3 kN/m under 1 kg, to rest and back."""
    time = np.arange(400) / RATE
    omega = np.sqrt(3000.0)
    since = time - 0.05
    value = np.where((since > 0) & (since < np.pi / omega), VELOCITY * omega * np.sin(omega * since), 0.0)
    return time, value + np.random.default_rng(0).normal(0, 0.05, time.size)


def written(time: np.ndarray, how: str) -> list[str]:
    moments = [BEGIN + timedelta(seconds=round(float(t), 6)) for t in time]
    return [moment.strftime(how) for moment in moments]


HOW: dict[str, Callable[[np.ndarray], list[str]]] = {
    "a date and a time": lambda time: written(time, "%Y-%m-%d %H:%M:%S.%f"),
    "ISO": lambda time: written(time, "%Y-%m-%dT%H:%M:%S.%fZ"),
    "in German": lambda time: written(time, "%d.%m.%Y %H:%M:%S,%f"),
    "of half a day": lambda time: written(time, "%m/%d/%Y %I:%M:%S.%f %p"),
    "of day": lambda time: written(time, "%H:%M:%S.%f"),
    "in minutes": lambda time: written(time, "%M:%S.%f"),
}


@pytest.mark.parametrize("how", HOW)
def test_times_of_day_are_seconds_since_the_first(how: str) -> None:
    import pyarrow as pa

    time, _ = recording()
    cells = pa.array([*HOW[how](time), None, "late"])
    found, _ = seconds(cells)
    assert found is not None
    # Rounding of seconds of a day, and of the six decimals.
    np.testing.assert_allclose(found[:-2], time, rtol=0, atol=1e-9)
    assert np.isnan(found[-2:]).all()


@pytest.mark.parametrize("cells", [["0.5", "1.5"], ["1:2", "3"], ["a:b", "c:d"], [None, None]])
def test_other_cells_are_no_times(cells: list[str | None]) -> None:
    import pyarrow as pa

    assert seconds(pa.array(cells, pa.string())) is None


def folder(tmp_path: Path, table: pd.DataFrame, parquet: bool = False) -> Path:
    recorded = tmp_path / "recorded"
    recorded.mkdir()
    if parquet:
        table.to_parquet(recorded / "s1.parquet")
    else:
        table.to_csv(recorded / "s1.csv", index=False, sep=";")
    return recorded


FACTS = {"mass_kg": 1.0, "velocity_m_s": VELOCITY, "subject": "s1"}


def made(recorded: Path, tmp_path: Path, **options: object) -> bt.Dataset:
    return bt.init_dataset(
        recorded, tmp_path / "made", quantity="deceleration", unit="m/s^2", given=FACTS, **options
    )


@pytest.mark.parametrize(("how", "name"), [("in German", "Zeitstempel"), ("of day", "time")])
def test_a_column_of_clock_times_is_the_time(how: str, name: str, tmp_path: Path) -> None:
    time, value = recording()
    data = made(folder(tmp_path, pd.DataFrame({name: HOW[how](time), "Impact": value})), tmp_path)
    np.testing.assert_allclose(data.traces[0].time_s, time, rtol=0, atol=1e-9)
    np.testing.assert_allclose(data.traces[0].value, value)


def test_a_parquet_column_of_moments_is_the_time(tmp_path: Path) -> None:
    time, value = recording()
    moments = pd.to_datetime([BEGIN + timedelta(seconds=float(t)) for t in time])
    data = made(folder(tmp_path, pd.DataFrame({"at": moments, "Impact": value}), parquet=True), tmp_path)
    np.testing.assert_allclose(data.traces[0].time_s, time, rtol=0, atol=1e-6)


@pytest.mark.parametrize("digits", [6, 3, 2])
def test_a_rate_goes_with_times_as_coarse_as_they_are(digits: int, tmp_path: Path) -> None:
    time, value = recording()
    table = pd.DataFrame({"Time (s)": np.floor(time * 10**digits) / 10**digits, "Impact": value})
    data = made(folder(tmp_path, table), tmp_path, rate_hz=RATE)
    np.testing.assert_allclose(data.traces[0].time_s, time, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("digits", "lost"), [(6, 1), (3, 3), (2, 40)])
def test_samples_that_are_lost_under_a_rate_are_seen(digits: int, lost: int, tmp_path: Path) -> None:
    time, value = recording()
    keep = np.delete(np.arange(time.size), np.arange(200, 200 + lost))
    table = pd.DataFrame({"Time (s)": np.floor(time[keep] * 10**digits) / 10**digits, "Impact": value[keep]})
    with pytest.raises(InputError, match="Samples are lost there") as refused:
        made(folder(tmp_path, table), tmp_path, rate_hz=RATE)
    (problem,) = refused.value.problems
    assert abs(problem.row - 202) <= 10**-digits * RATE


def test_a_rate_that_the_times_contradict_is_refused(tmp_path: Path) -> None:
    time, value = recording()
    recorded = folder(tmp_path, pd.DataFrame({"Time (ms)": 1e3 * time, "Impact": value}))
    with pytest.raises(InputError, match=r"found .2000 Hz.*expected the stated sampling rate, 2100 Hz"):
        made(recorded, tmp_path, rate_hz=2100.0)


@pytest.mark.parametrize(
    ("style", "begin", "within"), [(1, 0.4, 1e-8), (2, 45_000.4, 2e-6), (3, 0.0, 1e-9), (4, 0.0, 1e-9)]
)
def test_times_of_a_workbook_keep_all_their_digits(
    style: int, begin: float, within: float, tmp_path: Path
) -> None:
    time, value = np.arange(200) / 12_800, np.sin(np.arange(200.0))
    cells = [Styled(float(begin + t / 86_400), style) for t in time]
    xlsx(tmp_path / "a.xlsx", [["Zeit", "a"], *map(list, zip(cells, value.tolist(), strict=True))])
    channels = contents_of(Source.at(tmp_path / "a.xlsx")).channels
    np.testing.assert_allclose(channels["Zeit"].values, time, rtol=0, atol=within)
