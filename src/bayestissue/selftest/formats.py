"""A recording in each format, written by the libraries at hand and read back in one dataset."""

from __future__ import annotations

import ctypes
import io
import struct
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.selftest.checks import Compared

type Samples = Float[np.ndarray, " sample"]

_RATE = 2000.0
# C3D files hold single precision; text has twelve digits.
_SINGLE, _TEXT = 1e-6, 1e-10


def read_back(folder: Path) -> list[Compared]:
    """Write the same recording in each format, and read all of them as one dataset."""
    from bayestissue.dataset import read_dataset, write_dataset

    time = np.arange(200) / _RATE
    value = np.where(time > 0.01, 100 * np.sin(90 * (time - 0.01)) * np.exp(-20 * (time - 0.01)), 0.0)
    writers = {end: write for end, write in WRITERS.items() if end != ".acq" or find_spec("bioread")}
    names = [f"recording{number}{end}" for number, end in enumerate(writers)]
    for name, write in zip(names, writers.values(), strict=True):
        write(folder / name, time, value)
    rows = {"impact": list(writers), "subject": "s", "trial": "t", "mass_kg": 0.7, "velocity_m_s": 1.5}
    write_dataset(
        folder,
        settings={"name": "formats", "signal": {"quantity": "deceleration", "unit": "m/s^2"}},
        impacts=pd.DataFrame(rows).assign(trace=names),
    )
    data = read_dataset(folder)
    comparisons = []
    for end, trace in zip(writers, data.traces, strict=True):
        same = len(trace.value) == len(value)
        difference = np.abs(np.asarray(trace.value) - value).max() / value.max() if same else np.inf
        clock = np.abs(np.diff(np.asarray(trace.time_s)) - 1 / _RATE).max() * _RATE if same else np.inf
        allowed = _SINGLE if end == ".c3d" else _TEXT
        off = max(difference, clock)
        expected = f"{len(value)} samples, {allowed:g} off at most"
        observed = f"{len(trace.value)} samples, {off:.0e} off"
        comparisons.append(Compared(end, expected, observed, bool(off <= allowed)))
    left_out = [end for end in WRITERS if end not in writers]
    return comparisons + [Compared(end, "its library is optional", "not installed", True) for end in left_out]


def _table(time: Samples, value: Samples) -> pd.DataFrame:
    return pd.DataFrame({"time_s": time, "value": value})


def _lvm(path: Path, time: Samples, value: Samples) -> None:
    """LabVIEW's text: a header, that of a block with one channel, and its samples."""
    end = "***End_of_Header***"
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab"]
    head += ["Decimal_Separator\t.", "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tRelative", end, ""]
    head += ["Channels\t1\t", f"Samples\t{len(time)}", "Y_Unit_Label\tm/s^2", "X_Dimension\tTime"]
    head += [f"X0\t{time[0]:.9g}", f"Delta_X\t{1 / _RATE:.9g}", end, "X_Value\tvalue\tComment"]
    body = [f"{t:.9g}\t{v:.12g}" for t, v in zip(time, value, strict=True)]
    path.write_text("\n".join([*head, *body]) + "\n", encoding="utf-8")


def _tdms(path: Path, time: Samples, value: Samples) -> None:
    from nptdms import ChannelObject, TdmsWriter

    clock = {"wf_increment": 1 / _RATE, "wf_start_offset": float(time[0])}
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("Impact", "value", value, properties=clock)])


def _mat(path: Path, time: Samples, value: Samples) -> None:
    from scipy.io import savemat

    savemat(path, {"time_s": time, "value": value})


def _hdf5(path: Path, time: Samples, value: Samples) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["time_s"], file["value"] = time, value


def _c3d(path: Path, time: Samples, value: Samples) -> None:
    """One analog channel in floats, a sample a frame: header, parameters, data, in blocks of 512 bytes."""

    def group(number: int, name: str) -> bytes:
        return struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<HB", 3, 0)

    def parameter(number: int, name: str, kind: int, sizes: tuple[int, ...], data: bytes) -> bytes:
        body = struct.pack("<bB", kind, len(sizes)) + bytes(sizes) + data + b"\0"
        return struct.pack("<bb", len(name), number) + name.encode() + struct.pack("<H", 2 + len(body)) + body

    count, scale = len(value), struct.pack("<f", 1.0)
    entries = group(1, "POINT") + group(2, "ANALOG")
    entries += parameter(1, "USED", 2, (), struct.pack("<h", 0))
    entries += parameter(2, "USED", 2, (), struct.pack("<h", 1))
    entries += parameter(2, "RATE", 4, (), struct.pack("<f", _RATE))
    entries += parameter(2, "GEN_SCALE", 4, (), scale) + parameter(2, "SCALE", 4, (1,), scale)
    entries += parameter(2, "OFFSET", 2, (1,), struct.pack("<h", 0))
    entries += parameter(2, "LABELS", -1, (5, 1), b"value") + parameter(2, "UNITS", -1, (5, 1), b"m/s^2")
    blocks = -(-(4 + len(entries) + 2) // 512)
    parameters = (struct.pack("<BBBB", 1, 0x50, blocks, 84) + entries).ljust(512 * blocks, b"\0")
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0, 1, 1, count, 0, -1.0, 2 + blocks, 1, _RATE)
    path.write_bytes(header.ljust(512, b"\0") + parameters + value.astype("<f4").tobytes())


def _acq(path: Path, time: Samples, value: Samples) -> None:
    acq(path, {"value": value}, _RATE, {"value": "m/s^2"})


def acq(path: Path, channels: Mapping[str, Samples], rate: float, units: Mapping[str, str]) -> None:
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


WRITERS: dict[str, Callable[[Path, Samples, Samples], None]] = {
    ".csv": lambda path, time, value: _table(time, value).to_csv(path, index=False),
    ".csv.gz": lambda path, time, value: _table(time, value).to_csv(path, index=False),
    ".parquet": lambda path, time, value: _table(time, value).to_parquet(path),
    ".xlsx": lambda path, time, value: _table(time, value).to_excel(path, index=False, engine="xlsxwriter"),
    ".lvm": _lvm,
    ".tdms": _tdms,
    ".mat": _mat,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".c3d": _c3d,
    ".acq": _acq,
}
