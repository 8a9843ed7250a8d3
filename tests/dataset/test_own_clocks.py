"""A force with a clock of its own beside the deceleration: its times are the truth, or it is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import read_dataset, write_dataset
from bayestissue.recordings.intake import choices_of
from bayestissue.studies.init import prepare, write
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
    impact = {"impact": "a", "subject": "s", "mass_kg": MASS, "velocity_m_s": 0.6, "trace": file}
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


@pytest.mark.parametrize("force_first", [False, True])
def test_init_leaves_each_channel_its_clock(force_first: bool, tmp_path: Path) -> None:
    (folder := tmp_path / "recorded").mkdir()
    first, own = clocks("other rate")
    parts = (
        {"Time (s)1": first, "Acc (m/s^2)": pulse(first)},
        {"Time (s)2": own, "Force (N)": MASS * pulse(own)},
    )
    table = {name: pd.Series(part[name].round(9)) for part in parts[:: 1 - 2 * force_first] for name in part}
    text = pd.DataFrame(table).to_csv(index=False)
    (folder / "a.csv").write_text(text.replace("(s)1", "(s)").replace("(s)2", "(s)"))
    shared = {"subject": "s1", "mass_kg": str(MASS), "velocity_m_s": "0.6"}
    time = f"Time (s) (column {1 + 2 * force_first})"
    made = write(
        prepare(folder, choices_of(quantity="deceleration", time=time, given=shared)), tmp_path / "made"
    )
    require_truth(made.dataset, first, own)


@pytest.mark.parametrize(
    ("names", "right"),
    [
        (("Time", "Acc", "Time_force", "Force"), True),
        (("Time_force", "Force", "Time", "Acc"), True),
        (("Time", "Time_force", "Acc", "Force"), False),
        (("Time_force", "Time", "Acc", "Force"), False),
        (("Acc", "Force", "Time", "t_force"), False),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "mat", "long", "arrays"])
def test_where_places_do_not_tell_the_times_are_asked_for(
    names: tuple[str, ...], right: bool, kind: str, tmp_path: Path
) -> None:
    first, own = clocks("late")
    values = {"Time": first, "Acc": pulse(first), "Force": MASS * pulse(own)}
    table = {name: values.get(name, own) for name in names}

    def read(**channel: Any) -> bt.Dataset:
        folder = dataset_of(tmp_path, f"a.{kind}", "Time", **channel)
        if kind == "csv":
            pd.DataFrame(table).to_csv(folder / "a.csv", index=False)
        elif kind == "mat":
            savemat(folder / "a.mat", table)
        else:
            frame = pd.DataFrame({"impact": "a", **table})
            frame.to_csv(folder / "traces.csv", index=False)
            impacts = pd.read_csv(folder / "impacts.csv").drop(columns="trace")
            impacts.to_csv(folder / "impacts.csv", index=False)
            if kind == "arrays":
                cell = {"quantity": "force", "place": "impactor", "unit": "N", "value_column": "Force"}
                said: Any = {
                    "quantity": "deceleration",
                    "unit": "m/s^2",
                    "channels": {"cell": cell | channel},
                }
                return bt.dataset(impacts, frame, time_column="Time", value_column="Acc", **said)
        return read_dataset(folder)

    if right:
        require_truth(read(), first, own)
    else:
        with pytest.raises(InputError, match=r"Write time_column under"):
            read()
    stated = next(name for name in names if name.endswith("_force"))
    require_truth(read(time_column=stated), first, own)


@pytest.mark.parametrize("further", ["Time (ms)", "Clock time", "t (°C)"])
def test_another_column_of_the_same_clock_is_no_question(further: str, tmp_path: Path) -> None:
    first, _ = clocks("late")
    of_day = pd.to_datetime(BEGUN) + pd.to_timedelta(first, "s")
    cells = {
        "Time (ms)": 1e3 * first,
        "Clock time": of_day.strftime("%H:%M:%S.%f"),
        "t (°C)": 21 + 3 * first,
    }
    table = {"Time (s)": first, further: cells[further], "Acc": pulse(first), "Force": MASS * pulse(first)}
    pd.DataFrame(table).to_csv(tmp_path / "a.csv", index=False)
    require_truth(read_dataset(dataset_of(tmp_path, "a.csv", "Time (s)")), first, first)


@pytest.mark.parametrize("how", ["of day", "in ms", "parquet"])
def test_own_times_may_be_written_otherwise(how: str, tmp_path: Path) -> None:
    first, own = clocks("late")
    names = ("Time", "Time force")
    if how == "in ms":
        written: list[Any] = [first, 1e3 * own]
        names = ("Time (s)", "Time (ms)")
    else:
        written = [
            pd.to_datetime(BEGUN) + pd.to_timedelta((1e6 * time).round(), "us") for time in (first, own)
        ]
    if how == "of day":
        written = [time.strftime("%H:%M:%S.%f") for time in written]
    table = pd.DataFrame(
        {names[0]: written[0], "Acc": pulse(first), names[1]: written[1], "Force": MASS * pulse(own)}
    )
    file = "a.parquet" if how == "parquet" else "a.csv"
    table.to_parquet(tmp_path / file) if how == "parquet" else table.to_csv(tmp_path / file, index=False)
    require_truth(read_dataset(dataset_of(tmp_path, file, names[0])), first, own)
