"""Files of recorders whose own software writes them in a way that a test can call."""

from __future__ import annotations

import ctypes
import io
from pathlib import Path

import ezc3d
import numpy as np
from bioread import headers


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


def acq(path: Path, channels: dict[str, np.ndarray], rate: float, units: dict[str, str]) -> None:
    """An AcqKnowledge 3.8.1 file, set by the structures with which bioread reads one."""
    revision, order = 41, "<"
    count, samples = len(channels), len(next(iter(channels.values())))

    def filled(kind: type, **fields: object) -> ctypes.LittleEndianStructure:
        header = kind.for_revision(revision, order)  # type: ignore[attr-defined]
        structure = header._struct_class()
        for name, value in fields.items():
            setattr(structure, name, value)
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
