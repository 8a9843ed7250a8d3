"""Files of recorders whose own software writes them in a way that a test can call."""

from __future__ import annotations

import ctypes
import io
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import ezc3d
import numpy as np
import xlsxwriter


def lvm(
    path: Path,
    time: np.ndarray,
    channels: dict[str, np.ndarray],
    *,
    x_columns: str = "One",
    decimal: str = ".",
    samples: int | None = None,
    comment: bool = True,
    unit: str = "m/s^2",
    intervals: list[float | None] | None = None,
    begun: list[str] | None = None,
) -> None:
    """A LabVIEW measurement file: a header, a block header per channel, and the data.

    Channels may be shorter than the time; ``intervals`` are theirs where they differ from those of the time,
    and ``begun`` are times of day.
    """
    count, rows = len(channels), len(time)
    steps = [f"{step or time[1] - time[0]:.9g}" for step in intervals or [None] * count]

    def line(key: str, *cells: object) -> str:
        return "\t".join([key, *(str(cell) for cell in cells)])

    per_channel = [""] * count
    head = [
        "LabVIEW Measurement",
        line("Writer_Version", 2),
        line("Reader_Version", 2),
        line("Separator", "Tab"),
        line("Decimal_Separator", decimal),
        line("Multi_Headings", "No"),
        line("X_Columns", x_columns),
        line("Time_Pref", "Relative"),
        line("Date", "2024/05/17"),
        "***End_of_Header***",
        "",
        line("Channels", count, *per_channel),
        line("Samples", *[len(each) if samples is None else samples for each in channels.values()]),
        line("Y_Unit_Label", *[unit] * count),
        *([line("Date", *["2024/05/17"] * count), line("Time", *begun)] if begun else []),
        line("X_Dimension", *["Time"] * count),
        line("X0", *[f"{time[0]!r}".replace("np.float64(", "").rstrip(")")] * count),
        line("Delta_X", *steps),
        "***End_of_Header***",
    ]
    multi = x_columns == "Multi"
    names = [cell for name in channels for cell in (["X_Value", name] if multi else [name])]
    head.append(line(*([] if multi else ["X_Value"]), *names, *(["Comment"] if comment else [])))
    body = []
    for row in range(rows):
        first = "" if x_columns == "No" else f"{time[row]:.9g}"
        cells = [f"{values[row]:.12g}" if row < len(values) else "" for values in channels.values()]
        if multi:
            cells = [cell for value in cells for cell in (first, value)]
            body.append("\t".join(cells))
        else:
            body.append("\t".join([first, *cells]))
    path.write_text("\n".join([*head, *(row.replace(".", decimal) for row in body)]) + "\n")


def c3d(
    path: Path, channels: dict[str, np.ndarray], rate: float, units: dict[str, str], points: int = 0
) -> None:
    """A C3D file by ezc3d, ten analog samples a frame, with ``points`` markers beside them."""
    file = ezc3d.c3d()
    frames = len(next(iter(channels.values()))) // 10
    file["parameters"]["POINT"]["RATE"]["value"] = [rate / 10]
    file["parameters"]["POINT"]["LABELS"]["value"] = [f"m{number}" for number in range(points)]
    file["data"]["points"] = np.ones((4, points, frames))
    about = file["parameters"]["ANALOG"]
    about["RATE"]["value"], about["LABELS"]["value"] = [rate], list(channels)
    about["UNITS"]["value"] = [units.get(name, "") for name in channels]
    file["data"]["analogs"] = np.array([list(channels.values())])
    file.write(str(path))


def markers(path: Path, height: np.ndarray, rate: float, unit: str = "mm", hidden: int | None = None) -> None:
    """A C3D file without analog channels: a marker HAMR at a height, one at rest; one is not seen once."""
    file = ezc3d.c3d()
    points = file["parameters"]["POINT"]
    points["RATE"]["value"], points["UNITS"]["value"] = [rate], [unit]
    points["LABELS"]["value"] = ["HAMR", "REST"]
    data = np.zeros((4, 2, len(height)))
    data[2, 0] = height
    file["data"]["points"] = data
    if hidden is not None:
        residuals = np.zeros((1, 2, len(height)))
        residuals[0, 0, hidden] = -1
        file["data"]["meta_points"]["residuals"] = residuals
    file.write(str(path))


def xlsx(path: Path, rows: list[list[object]], *, before: tuple[str, ...] = ()) -> None:
    """An Excel workbook of one sheet with cells; empty sheets come ``before``."""
    workbook(path, {**{name: [] for name in before}, "Messung": rows})


# How a workbook shows its times, which are numbers of days.
STYLES = ("hh:mm:ss.000", "yyyy-mm-dd hh:mm:ss.000", "[h]:mm:ss.000", "mm:ss.0")


class Styled(NamedTuple):
    """A number that a cell shows by one of `STYLES`, from 1 on."""

    number: float
    style: int


def workbook(path: Path, sheets: dict[str, list[list[object]]], *, hidden: tuple[str, ...] = ()) -> None:
    """An Excel workbook: numbers as numbers, the rest as text; some sheets are ``hidden``."""
    with xlsxwriter.Workbook(path) as book:
        styles = [book.add_format({"num_format": style}) for style in STYLES]
        for name, rows in sheets.items():
            sheet = book.add_worksheet(name)
            if name in hidden:
                sheet.hide()
            for place in ((n, k) for n, row in enumerate(rows) for k in range(len(row))):
                value = rows[place[0]][place[1]]
                if isinstance(value, Styled):
                    sheet.write_number(*place, value.number, styles[value.style - 1])
                elif isinstance(value, float | int):
                    sheet.write_number(*place, value)
                else:
                    sheet.write_string(*place, str(value))


def acq(path: Path, channels: Mapping[str, np.ndarray], rate: float, units: Mapping[str, str]) -> None:
    """An AcqKnowledge 3.8.1 file, set by the structures with which bioread reads one."""
    from bioread import headers

    revision, order = 41, "<"
    count, samples = len(channels), len(next(iter(channels.values())))

    def filled(kind: type, **fields: object) -> ctypes.LittleEndianStructure:
        header = kind.for_revision(revision, order)  # type: ignore[attr-defined]
        structure: ctypes.LittleEndianStructure = header._struct_class()
        for name, content in fields.items():
            setattr(structure, name, content)
        return structure

    graph = filled(headers.GraphHeader, lVersion=revision, nChannels=count, dSampleTime=1000 / rate)
    graph.lExtItemHeaderLen = ctypes.sizeof(graph)
    out = io.BytesIO()
    out.write(bytes(graph))
    for number, name in enumerate(channels):
        channel = filled(
            headers.ChannelHeader,
            nNum=number,
            szCommentText=name.encode(),
            szUnitsText=units.get(name, "").encode(),
            lBufLength=samples,
            dAmplScale=1.0,
            dAmplOffset=0.0,
            nChanOrder=number,
            nVarSampleDivider=1,
        )
        channel.lChanHeaderLen = ctypes.sizeof(channel)
        out.write(bytes(channel))
    foreign = filled(headers.ForeignHeader)
    foreign.nLength = ctypes.sizeof(foreign)
    out.write(bytes(foreign))
    for _ in channels:
        out.write(bytes(filled(headers.ChannelDTypeHeader, nSize=8, nType=1)))
    out.write(np.column_stack(list(channels.values())).astype("<f8").tobytes())
    path.write_bytes(out.getvalue())
