"""C3D files of motion laboratories: analog channels (force plates, accelerometers), else markers.

The file is taken apart here rather than by a library in compiled code: such code trusts the sizes that a file
states, and a damaged file can end the whole program. Source: The C3D File Format User Guide, Motion Lab
Systems (header, parameter section, and "Analog data" for the scales).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from bayestissue.dataset.files import require_small
from bayestissue.dataset.formats.channel import Channel, Contents, Format, UnfitError, clock_of, unique

# Bytes of a block, the second byte of every file, and the numbers of a point: x, y, z and its residual.
BLOCK, KEY, COORDINATES = 512, 0x50, 4
_ORDERS = {84: "<", 86: ">"}
_TYPES = {-1: "S1", 1: "i1", 2: "i2", 4: "f4"}

type Parameters = dict[tuple[str, str], Any]


class _Header(NamedTuple):
    """What the first block says: counts per frame of the points, the first and last frame, the rate."""

    points: int
    analog: int
    first: int
    last: int
    gap: int
    scale: float
    data_block: int
    samples: int
    rate: float


def read(data: bytes, label: str) -> Contents:
    """The analog channels by their label, in the units that ``ANALOG:UNITS`` gives.

    A stored number r of a channel stands for (r - OFFSET) · SCALE · GEN_SCALE, and the samples are
    1 / ``ANALOG:RATE`` apart, the first at 0 s. Of a file without such channels the coordinates of its
    markers, as ``LABEL.x``, ``.y`` and ``.z`` in ``POINT:UNITS``, ``POINT:RATE`` times a second.

    Raises:
        UnfitError: there is neither an analog channel nor a marker, the file is of a DEC computer, or its end
            is missing.
        ValueError, IndexError, struct.error: the file is damaged, or is no C3D file.
    """
    if data[1] != KEY:
        raise ValueError("no C3D file: its second byte is not 0x50")
    order, parameters = _parameters(data)
    header = _header(data, order)
    count = header.analog // header.samples if header.samples else 0
    if not count and not header.points:
        raise UnfitError(
            "analog channels, or markers",
            "Export the recording with its analog data: the accelerometer's, or a force plate's.",
            "neither",
        )
    frames = _frames(header, parameters)
    stored = np.dtype(f"{order}f4" if header.scale < 0 else f"{order}{_integer(parameters)}")
    words = COORDINATES * header.points + header.analog
    # Held once as they are stored, and once as numbers of 8 bytes.
    require_small(8.0 * frames * (header.analog or 3 * header.points), label)
    begin = BLOCK * (header.data_block - 1)
    if begin < BLOCK or begin + frames * words * stored.itemsize > len(data):
        raise UnfitError.cut_off(f"{frames} frames, as its header states")
    table = np.frombuffer(data, stored, frames * words, begin).reshape(frames, words)
    if not count:
        return Contents(_markers(table, parameters, header))
    raw = table[:, COORDINATES * header.points :].reshape(frames * header.samples, count)
    return Contents(_channels(raw, parameters, header))


def _markers(table: np.ndarray, parameters: Parameters, header: _Header) -> dict[str, Channel]:
    """Each coordinate of each marker; no number where the cameras did not see it."""
    count = header.points
    (rate,) = _numbers(parameters, "RATE", 1, header.rate, "POINT").tolist()
    clock = clock_of(rate, len(table))
    labels, (unit,) = _texts(parameters, "LABELS", count, "POINT"), _texts(parameters, "UNITS", 1, "POINT")
    points = table.reshape(len(table), count, COORDINATES).astype(np.float64)
    # Programs write a gap as a residual below 0, or as the origin, where no marker is to the last digit.
    visible = (points[..., -1:] >= 0) & (points[..., :3] != 0).any(axis=-1, keepdims=True)
    places = np.where(visible, (1.0 if header.scale < 0 else header.scale) * points, np.nan)
    return {
        f"{name}.{letter}": Channel(places[:, number, axis], clock, unit)
        for number, name in enumerate(unique(labels, "marker"))
        for axis, letter in enumerate("xyz")
    }


def _channels(raw: np.ndarray, parameters: Parameters, header: _Header) -> dict[str, Channel]:
    count = raw.shape[1]
    scales = _numbers(parameters, "SCALE", count, 1.0) * _numbers(parameters, "GEN_SCALE", 1, 1.0)
    offsets = _numbers(parameters, "OFFSET", count, 0.0)
    if _integer(parameters) == "u2":
        offsets = np.where(offsets < 0, offsets + 2.0**16, offsets)
    (rate,) = _numbers(parameters, "RATE", 1, header.rate * header.samples).tolist()
    clock = clock_of(rate, len(raw))
    labels, units = (_texts(parameters, name, count) for name in ("LABELS", "UNITS"))
    values = (raw.astype(np.float64) - offsets) * scales
    return {
        name: Channel(column, clock, unit)
        for name, column, unit in zip(unique(labels, "analog"), values.T, units, strict=True)
    }


def _header(data: bytes, order: str) -> _Header:
    header = _Header._make(struct.unpack_from(f"{order}HHHHHfHHf", data, 2))
    return header._replace(samples=0) if header.samples and header.analog % header.samples else header


def _frames(header: _Header, parameters: Parameters) -> int:
    """How many there are: the header's two bytes end at 65535, and longer files say more elsewhere."""
    ends = [parameters.get(("TRIAL", f"ACTUAL_{end}_FIELD")) for end in ("START", "END")]
    if all(isinstance(end, np.ndarray) and end.size == 2 for end in ends):
        first, last = (int(end[0]) % 2**16 + 2**16 * (int(end[1]) % 2**16) for end in ends if end is not None)
    else:
        first, last = header.first, header.last
    if last < first:
        raise ValueError("a last frame before the first")
    return last - first + 1


def _parameters(data: bytes) -> tuple[str, Parameters]:
    at = BLOCK * (data[0] - 1)
    if data[0] < 1 or data[at + 3] not in _ORDERS:
        raise UnfitError(
            "a C3D file of an Intel or MIPS computer",
            "Convert the file: any recent program writes it anew in Intel format.",
            "one of a DEC computer" if data[at + 3] == 85 else "another kind of file",
        )
    order, end = _ORDERS[data[at + 3]], at + BLOCK * data[at + 2]
    groups: dict[int, str] = {}
    parameters: dict[tuple[int, str], Any] = {}
    at += 4
    while at < min(end, len(data)):
        length, group = struct.unpack_from("bb", data, at)
        if not length:
            break
        name = data[at + 2 : at + 2 + abs(length)].decode("latin-1").upper()
        step_at = at + 2 + abs(length)
        (step,) = struct.unpack_from(f"{order}h", data, step_at)
        if group < 0:
            groups[-group] = name
        else:
            parameters[group, name] = _value(data, step_at + 2, order)
        if step <= 0:
            break
        at = step_at + step
    return order, {(groups.get(group, ""), name): value for (group, name), value in parameters.items()}


def _value(data: bytes, at: int, order: str) -> np.ndarray:
    kind, dimensions = struct.unpack_from("bB", data, at)
    if kind not in _TYPES:
        raise ValueError(f"a parameter of unknown type {kind}")
    shape = tuple(data[at + 2 : at + 2 + dimensions])
    values = np.frombuffer(data, f"{order}{_TYPES[kind]}", math.prod(shape), at + 2 + dimensions)
    return values.reshape(shape[::-1])


def _integer(parameters: Parameters) -> str:
    said = "".join(_strings(parameters.get(("ANALOG", "FORMAT"))))
    return "u2" if said.upper().startswith("UNSIGNED") else "i2"


def _numbers(
    parameters: Parameters, name: str, count: int, otherwise: float, group: str = "ANALOG"
) -> np.ndarray:
    value = parameters.get((group, name))
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "if" or value.size < count:
        return np.full(count, otherwise)
    return np.ravel(value)[:count].astype(np.float64)


def _texts(parameters: Parameters, name: str, count: int, group: str = "ANALOG") -> list[str]:
    """The texts of a parameter, one a channel; beyond 255 they go on under the name with a 2, a 3 ..."""
    parts = [name, *(f"{name}{number}" for number in range(2, 10))]
    texts = [text for part in parts for text in _strings(parameters.get((group, part)))]
    return [*texts, *[""] * count][:count]


def _strings(value: np.ndarray | None) -> Iterator[str]:
    if isinstance(value, np.ndarray) and value.dtype.kind == "S" and value.ndim and value.size:
        for row in value.reshape(-1, value.shape[-1]):
            yield row.tobytes().decode("utf-8", "replace").strip(" \0")


FORMAT = Format("C3D", ".c3d", read)
