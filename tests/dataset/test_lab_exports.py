"""Text files as other labs' software exports them: lines above the numbers, names, units, clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.dataset_file import SignalSettings
from bayestissue.recordings.dataset.dialect import Stated
from bayestissue.recordings.dataset.recorders import contents_of, read_recording
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.folder import look
from recorder_files import lvm

STEP = 1e-4
TIME = STEP * np.arange(60) - 0.001
VALUES = np.round(40 * np.sin(np.outer(np.arange(1, 7), 60 * TIME)), 4)


def export(path: Path, above: list[str], columns: int = 2, delimiter: str = "\t", end: str = "") -> Path:
    """The lines ``above``, and below them the times and as many columns, with ``end`` behind each row."""
    rows = np.column_stack([TIME, *VALUES[:columns]])
    lines = [delimiter.join(f"{cell:.6g}" for cell in row) + end for row in rows]
    path.write_text("\n".join([*above, *lines]) + "\n", encoding="utf-8")
    return path


def signal(**settings: object) -> SignalSettings:
    return SignalSettings.model_validate({"quantity": "deceleration", "unit": "m/s^2", **settings})


DTS = [
    "Test Date:,11/20/2020,,",
    "Test ID:,Drop 7,,",
    "Number of Channels:,2,,",
    "Channel Number:,1,2,",
    "Sensor Sensitivity:,0.191,0.202,",
    "Sample Rate (Hz):,10000,10000,",
    "Engineering Units:,g,N,",
    "Time,Scaled data in EU,Scaled data in EU,",
]
LABCHART = [
    "Interval=\t0.0001 s",
    "TimeFormat=\tStartOfBlock",
    "ChannelTitle=\tForce\tAcc",
    "Range=\t10.000 V\t5.000 V",
]
BIOWARE = [
    "BioWare for Windows",
    "Filename:\tdrop7.dat",
    "Sampling rate (Hz):\t10000",
    "Trigger\t0\t0\t0",
]
NAMES = "abs time\tFx\tFy\tFz\tMx\tFx\tFz"


@pytest.mark.parametrize(
    ("above", "columns", "delimiter", "names", "units"),
    [
        (DTS, 2, ",", ["Time", *(f"Scaled data in EU (column {n})" for n in (2, 3))], None),
        (["Channel,1,2", "Names,Fz,Acc", "Gain,1,2", "Time (s),Fz (N),Acc (g)"], 2, ",",
         ["Time (s)", "Fz (N)", "Acc (g)"], ["s", "N", "g"]),
        ([*BIOWARE, "abs time (s)\tFx\tFy"], 2, "\t", ["abs time (s)", "Fx", "Fy"], None),
        ([*BIOWARE, NAMES, "s\tN\tN\tN\tN·m\tN\tN", "s\tN\tN\tN\tN·m\tN\tN"], 6, "\t",
         ["abs time", "Fx (column 2)", "Fy", "Fz (column 4)", "Mx", "Fx (column 6)", "Fz (column 7)"],
         ["s", "N", "N", "N", "N·m", "N", "N"]),
        (["Remark;by hand", "Zeit;Kraft", ";N"], 1, ";", ["Zeit", "Kraft"], ["", "N"]),
        (["Remark,by hand,", "t,Acc,Force", "Units,g,N"], 2, ",", ["t", "Acc", "Force"], ["", "g", "N"]),
        (LABCHART, 2, "\t", ["ChannelTitle=", "Force", "Acc"], None),
        (["t;a;;", "Begin of data;;;"], 1, ";", ["t", "a"], None),
    ],
)  # fmt: skip
def test_names_are_the_last_row_of_text_above_the_numbers(
    above: list[str], columns: int, delimiter: str, names: list[str], units: list[str] | None, tmp_path: Path
) -> None:
    found = contents_of(Source.at(export(tmp_path / "a.txt", above, columns, delimiter)))
    assert list(found.channels) == names
    for name, written in zip(names, [TIME, *VALUES], strict=False):
        np.testing.assert_allclose(found.channels[name].values, written, rtol=1e-5, atol=0)
    if units is not None:
        assert [channel.unit for channel in found.channels.values()] == units
    again = read_recording(
        Source.at(tmp_path / "a.txt"), signal(time_column=names[0], value_column=names[-1])
    )
    np.testing.assert_array_equal(again.values, found.channels[names[-1]].values)
    assert again.rows[0] == found.first_row == len(above) + 1


def test_a_name_that_stands_twice_is_asked_for_by_its_place(tmp_path: Path) -> None:
    path = export(tmp_path / "a.txt", ["t\tFx (N)\tFx (N)"])
    assert [(name, c.unit) for name, c in contents_of(Source.at(path)).channels.items()] == [
        ("t", ""), ("Fx (N) (column 2)", "N"), ("Fx (N) (column 3)", "N"),
    ]  # fmt: skip
    with pytest.raises(
        InputError, match=r"every column name once.*Fx \(N\) \(column 2\), Fx \(N\) \(column 3\)"
    ):
        read_recording(Source.at(path), signal(value_column="Fx (N)"))


def test_what_goes_wrong_with_names_says_how_to_state_their_row(tmp_path: Path) -> None:
    path = export(tmp_path / "a.txt", ["Time,Acc", "by hand,none"], 1, ",")
    with pytest.raises(InputError, match="header_row"):
        read_recording(Source.at(path), signal(time_column="Zeit", value_column="Kraft"))
    assert list(contents_of(Source.at(path, stated=Stated(header_row=1))).channels) == ["Time", "Acc"]
    path.write_text("a,b\n" + "1,2,3\n" * 9)
    with pytest.raises(InputError, match=r"--text header_row=N"):
        contents_of(Source.at(path))


@pytest.mark.parametrize(
    "above",
    [
        ["X,CH1,CH2,Start,Increment", f"Sequence,Volt,Volt,-0.001,{STEP}"],
        ["X,CH1,CH2,Start,Increment,", f"Sequence,Volt,Volt,-0.001,{STEP},"],
        ["X,CH1,CH2,Start,Increment"],
    ],
)
@pytest.mark.parametrize("empty", ["", ",,"])
def test_start_and_increment_of_an_oscilloscope_are_its_clock(
    above: list[str], empty: str, tmp_path: Path
) -> None:
    rows = [f"{n},{one},{two}" for n, (one, two) in enumerate(zip(*VALUES[:2], strict=True))]
    rows = [row + empty for row in rows]
    if len(above) == 1:
        rows[0] = rows[0].removesuffix(empty) + f",-0.001,{STEP}"
    (tmp_path / "a.csv").write_text("\n".join([*above, *rows]) + "\n")
    found = contents_of(Source.at(tmp_path / "a.csv")).channels
    assert list(found) == ["X", "CH1", "CH2"]
    np.testing.assert_array_equal(found["CH2"].values, VALUES[1])
    again = read_recording(Source.at(tmp_path / "a.csv"), signal(value_column="CH2"))
    np.testing.assert_array_equal(again.values, VALUES[1])
    for clock in (found["CH1"].clock, again.clock):
        np.testing.assert_allclose(clock, TIME, rtol=0, atol=1e-15)


def test_cells_may_be_missing_behind_the_columns_in_use(tmp_path: Path) -> None:
    rows = [f"{t:.4f},{v}" for t, v in zip(TIME, VALUES[0], strict=True)]
    rows[3] += ",touched"
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time_s,value,comment", *rows]) + "\n")
    found = read_recording(Source.at(path), signal())
    np.testing.assert_array_equal(found.values, VALUES[0])
    assert list(contents_of(Source.at(path)).channels) == ["time_s", "value"]
    # A cell of a column that is used is missed with its row, and so is one too many.
    for cut in ("0.002", "0.002,1,2,3"):
        path.write_text("\n".join(["time_s,value,comment", *rows[:30], cut, *rows[31:]]) + "\n")
        with pytest.raises(InputError, match=r"a\.csv, row 32"):
            read_recording(Source.at(path), signal())


def labview(path: Path, **options: object) -> bytes:
    lvm(path, TIME, {"Impact": VALUES[0]}, **options)  # type: ignore[arg-type]
    return path.read_bytes()


def assert_whole(path: Path) -> None:
    for found in (contents_of(Source.at(path)).channels["Impact"], read_recording(Source.at(path), signal())):
        np.testing.assert_allclose(found.values, VALUES[0], rtol=1e-11, atol=0)
        np.testing.assert_allclose(found.clock, TIME, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["a.txt", "a.dat", "a.csv"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_labview_measurement_is_told_by_its_first_line(name: str, mark: bytes, tmp_path: Path) -> None:
    data = labview(tmp_path / "a.lvm")
    (tmp_path / name).write_bytes(mark + data)
    assert_whole(tmp_path / name)


@pytest.mark.parametrize("samples", [1, 20, 30])
@pytest.mark.parametrize("x_columns", ["One", "Multi"])
def test_a_header_of_the_first_piece_holds_for_all_rows(samples: int, x_columns: str, tmp_path: Path) -> None:
    labview(tmp_path / "a.lvm", samples=samples, x_columns=x_columns)
    assert_whole(tmp_path / "a.lvm")


def test_pieces_without_times_are_refused(tmp_path: Path) -> None:
    # Nothing says whether they follow each other.
    labview(tmp_path / "b.lvm", samples=20, x_columns="No")
    with pytest.raises(InputError, match="60 rows where 20 are stated"):
        contents_of(Source.at(tmp_path / "b.lvm"))


def test_decimal_commas_are_read_though_the_header_does_not_tell(tmp_path: Path) -> None:
    data = labview(tmp_path / "a.lvm", decimal=",")
    for header in (
        data,
        data.replace(b"X0\t-0.001", b"X0\t-0,001").replace(b"Delta_X\t0.0001", b"Delta_X\t0,0001"),
    ):
        (tmp_path / "a.lvm").write_bytes(header.replace(b"Decimal_Separator\t,\n", b""))
        assert_whole(tmp_path / "a.lvm")


@pytest.mark.parametrize("decimal", [".", ","])
def test_labview_numbers_without_a_header_are_a_table(decimal: str, tmp_path: Path) -> None:
    rows = [f"{t:.4f}\t{v}".replace(".", decimal) for t, v in zip(TIME, VALUES[0], strict=True)]
    (tmp_path / "a.lvm").write_text("\n".join(rows) + "\n")
    names = signal(time_column="column 1", value_column="column 2")
    found = read_recording(Source.at(tmp_path / "a.lvm"), names)
    np.testing.assert_array_equal(found.values, VALUES[0])
    np.testing.assert_allclose(found.clock, TIME, rtol=0, atol=1e-12)
    assert list(contents_of(Source.at(tmp_path / "a.lvm")).channels) == ["column 1", "column 2"]


def lines_of(name: str, time: np.ndarray, value: np.ndarray) -> list[str]:
    """A text of another ending than a text has."""
    pairs = list(zip(time, value, strict=True))
    if name == "a.133":
        stated = ["Sampling interval :0.0001", f"Number of samples :{len(time)}", "Unit :m/(s*s)"]
        return [*stated, *(f"{a:.6E}" for a in value)]
    if name == "a.d":
        return ["# run 3", "time acc", *(f"{t:.6f} {a:.6f}" for t, a in pairs)]
    if name == "a.mot":
        head = ["drop", "version=1", f"nRows={len(time)}", "nColumns=2", "inDegrees=no", "endheader"]
        return [*head, "time\tacc", *(f"{t:.6f}\t{a:.6f}" for t, a in pairs)]
    about = ["PathFileType\t4\t(X/Y/Z)\ta.trc", "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits"]
    about += ["1000\t1000\t200\t2\tmm", "Frame#\tTime\tM1\t\t\tM2\t\t", "\t\tX1\tY1\tZ1\tX2\tY2\tZ2", ""]
    return [*about, *(f"{i}\t{t:.6f}\t0\t{a:.6f}\t0\t1\t2\t3" for i, (t, a) in enumerate(pairs, 1))]


@pytest.mark.parametrize(
    ("name", "columns"),
    [("a.133", None), ("a.d", ("time", "acc")), ("a.mot", ("time", "acc")), ("a.trc", ("Time", "M1.Y1"))],
)
def test_a_text_is_read_whatever_it_is_called(
    name: str, columns: tuple[str, str] | None, tmp_path: Path
) -> None:
    time, value = np.arange(200) / 1000, np.sin(np.arange(200) / 10)
    (tmp_path / name).write_text("\n".join(lines_of(name, time, value)) + "\n")
    channels = contents_of(Source.at(tmp_path / name)).channels
    own = columns or (None, next(iter(channels)))
    np.testing.assert_allclose(channels[own[1]].values, value, atol=1e-6)
    if columns:
        np.testing.assert_allclose(channels[columns[0]].values, time, atol=1e-6)
        chosen = signal(time_column=columns[0], value_column=columns[1])
        np.testing.assert_allclose(read_recording(Source.at(tmp_path / name), chosen).clock, time, atol=1e-6)
    assert [file.name for file in look(tmp_path).files] == [name]


@pytest.mark.parametrize("content", [b"# notes\nof the day\n" * 20, b"1 2\n3 4\n" * 20 + b"\0", b""])
def test_what_is_no_text_of_numbers_is_not_read_as_one(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.d").write_bytes(content)
    with pytest.raises(InputError, match="ending in"):
        contents_of(Source.at(tmp_path / "a.d"))
