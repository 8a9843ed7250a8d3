"""A force with a clock of its own beside the deceleration: its times are the truth, or it is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset, write_dataset
from recorder_files import lvm

MASS, RATE, SAMPLES = 1.2, 5000.0, 400
BEGUN = np.datetime64("2024-05-17T23:59:59.998000")
# When the force begins (s), its share of the rate, and of the samples.
HOW = {
    "early": (-0.002, 1.0, 1.0),
    "late": (0.004, 1.0, 1.0),
    "other rate": (0.004, 0.5, 0.5),
    "other length": (0.004, 1.0, 0.6),
}


def pulse(time: np.ndarray) -> np.ndarray:
    """A deceleration from 20 ms on."""
    return np.where((time > 0.02) & (time < 0.04), 90 * np.sin(np.pi * (time - 0.02) / 0.02), 0.0)


def clocks(how: str) -> tuple[np.ndarray, np.ndarray]:
    """The times of both channels, s."""
    late, rate, share = HOW[how]
    return np.arange(SAMPLES) / RATE, late + np.arange(int(share * SAMPLES)) / (rate * RATE)


def side_by_side(**columns: np.ndarray) -> str:
    """Columns of any length as a table, whose names lose the digit that keeps them apart."""
    table = pd.DataFrame({name: pd.Series(values.round(9)) for name, values in columns.items()})
    lines = table.to_csv(index=False).split("\n")
    return "\n".join([lines[0].replace("1", "").replace("2", ""), *lines[1:]])


def tdms(path: Path, first: np.ndarray, own: np.ndarray) -> None:
    channels = []
    for name, time, value in (("Acc", first, pulse(first)), ("Force", own, MASS * pulse(own))):
        begun = BEGUN + np.timedelta64(round(1e6 * time[0]), "us")
        about = {"wf_start_time": begun, "wf_start_offset": 0.0, "wf_increment": time[1] - time[0]}
        channels.append(ChannelObject(name, name, value, properties=about))
    with TdmsWriter(path) as writer:
        writer.write_segment(channels)


def labview(path: Path, first: np.ndarray, own: np.ndarray) -> None:
    each = {"Acc": pulse(first), "Force": MASS * pulse(own)}
    begun = [str(BEGUN + np.timedelta64(round(1e6 * time[0]), "us")).split("T")[1] for time in (first, own)]
    steps = [None, float(own[1] - own[0])]
    lvm(path, first, each, x_columns="No", unit="", intervals=steps, begun=begun)


def columns(path: Path, first: np.ndarray, own: np.ndarray) -> None:
    path.write_text(side_by_side(Time1=first, Acc=pulse(first), Time2=own, Force=MASS * pulse(own)))


WRITERS = {"tdms": (tdms, None), "lvm": (labview, None), "csv": (columns, "Time (column 1)")}


def dataset_of(folder: Path, file: str, time: str | None, **channel: Any) -> Path:
    signal = {"quantity": "deceleration", "unit": "m/s^2", "value_column": "Acc"}
    cell = {"name": "cell", "quantity": "force", "place": "impactor", "unit": "N", "value_column": "Force"}
    settings = {
        "name": "two clocks",
        "signal": signal | ({"time_column": time} if time else {}),
        "channel": [cell | channel],
    }
    impact = {"impact": "a", "subject": "s", "mass_kg": MASS, "velocity_m_s": 0.6}
    impact |= {"trace": file} if file != "traces.csv" else {}
    write_dataset(folder, settings=settings, impacts=pd.DataFrame([impact]))
    return folder


def require_truth(data: bt.Dataset, first: np.ndarray, own: np.ndarray) -> None:
    (trace,), (force,) = data.traces, data.further[0]
    begin = trace.time_s[0] - first[0]
    np.testing.assert_allclose(trace.time_s, begin + first, atol=1e-8)
    np.testing.assert_allclose(force.time_s, begin + own, atol=1e-8)
    np.testing.assert_allclose(force.value, MASS * pulse(own), atol=1e-6)


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("kind", WRITERS)
def test_twelve_clocks_of_two_channels_are_right(kind: str, how: str, tmp_path: Path) -> None:
    (writer, time), (first, own) = WRITERS[kind], clocks(how)
    writer(tmp_path / f"a.{kind}", first, own)
    require_truth(read_dataset(dataset_of(tmp_path, f"a.{kind}", time)), first, own)


@pytest.mark.parametrize("x_columns", ["One", "Multi"])
def test_x_values_of_labview_count_from_each_channel_s_time(x_columns: str, tmp_path: Path) -> None:
    first, own = clocks("late")
    each = {"Acc": pulse(first), "Force": MASS * pulse(own)}
    begun = ["23:59:59.9980000", "0:00:00.0020000"]
    lvm(tmp_path / "a.lvm", first, each, x_columns=x_columns, unit="", begun=begun)
    require_truth(read_dataset(dataset_of(tmp_path, "a.lvm", None)), first, own)


@pytest.mark.parametrize(
    ("names", "right"),
    [
        (("Time_force", "Force", "Time", "Acc"), True),
        (("Time_force", "Time", "Acc", "Force"), False),
        (("Acc", "Force", "Time", "t_force"), False),
    ],
)
@pytest.mark.parametrize("file", ["a.csv", "traces.csv"])
def test_where_places_do_not_tell_the_times_are_asked_for(
    names: tuple[str, ...], right: bool, file: str, tmp_path: Path
) -> None:
    first, own = clocks("late")
    values = {"Time": first, "Acc": pulse(first), "Force": MASS * pulse(own)}

    def read(**channel: Any) -> bt.Dataset:
        table = {"impact": "a"} | {name: values.get(name, own) for name in names}
        pd.DataFrame(table).to_csv(tmp_path / file, index=False)
        return read_dataset(dataset_of(tmp_path, file, "Time", **channel))

    if right:
        require_truth(read(), first, own)
    else:
        with pytest.raises(InputError, match=r"Write time_column under"):
            read()
    stated = next(name for name in names if name.endswith("_force"))
    require_truth(read(time_column=stated), first, own)


def of_day(time: np.ndarray) -> pd.Index:
    return (pd.to_datetime(BEGUN) + pd.to_timedelta((1e6 * time).round(), "us")).strftime("%H:%M:%S.%f")


@pytest.mark.parametrize(
    ("further", "cells"),
    [("Time (ms)", lambda t: 1e3 * t), ("Clock time", of_day), ("t (°C)", lambda t: 21 + 3 * t)],
)
def test_another_column_of_the_same_clock_is_no_question(
    further: str, cells: Callable[[np.ndarray], object], tmp_path: Path
) -> None:
    first, _ = clocks("late")
    table = {"Time (s)": first, further: cells(first), "Acc": pulse(first), "Force": MASS * pulse(first)}
    pd.DataFrame(table).to_csv(tmp_path / "a.csv", index=False)
    require_truth(read_dataset(dataset_of(tmp_path, "a.csv", "Time (s)")), first, first)


@pytest.mark.parametrize("how", ["of day", "in ms"])
def test_own_times_may_be_written_otherwise(how: str, tmp_path: Path) -> None:
    first, own = clocks("late")
    names, times = ("Time (s)", "Time (ms)"), (first, 1e3 * own)
    if how == "of day":
        names, times = ("Time", "Time force"), (of_day(first), of_day(own))
    table = {names[0]: times[0], "Acc": pulse(first), names[1]: times[1], "Force": MASS * pulse(own)}
    pd.DataFrame(table).to_csv(tmp_path / "a.csv", index=False)
    require_truth(read_dataset(dataset_of(tmp_path, "a.csv", names[0])), first, own)
