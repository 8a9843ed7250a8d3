"""C3D files of motion laboratories: analog channels (force plates, accelerometers), else markers.

The file is taken apart here. Libraries in compiled code trust the sizes that a file states, and a damaged
one can end the whole program; c3d 0.6, in Python, refuses files whose header and parameters differ in the
last digit of a rate, and reads frames one by one. Source: The C3D File Format User Guide, Motion Lab Systems
(header, parameter section, and "Analog data" for the scales).
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np

from bayestissue.recordings.dataset.formats.channel import (
    CUT_OFF,
    Channel,
    Contents,
    UnfitError,
    clock_of,
    unique,
)
from bayestissue.recordings.dataset.source_files import require_small

# Bytes of a block, the second byte of every file, and the numbers of a point: x, y, z and its residual.
BLOCK, KEY, COORDINATES = 512, 0x50, 4
_ORDERS = {84: "<", 86: ">"}
_TYPES = {-1: "S1", 1: "i1", 2: "i2", 4: "f4"}


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


class _Parameters(dict[tuple[str, str], np.ndarray]):
    """The arrays of the parameter section, by their group and name."""

    def numbers(self, group: str, name: str, count: int, otherwise: float) -> np.ndarray:
        """The first ``count`` numbers; ``otherwise`` where there are not so many."""
        value = self.get((group, name), np.empty(0))
        if value.dtype.kind not in "if" or value.size < count:
            return np.full(count, otherwise)
        return np.ravel(value)[:count].astype(np.float64)

    def texts(self, group: str, name: str, count: int) -> list[str]:
        """The texts, one a channel; beyond 255 they go on under the name with a 2, a 3 ..."""
        texts = []
        for part in (name, *(f"{name}{number}" for number in range(2, 10))):
            value = self.get((group, part), np.empty(0))
            if value.dtype.kind == "S" and value.ndim and value.size:
                rows = value.reshape(-1, value.shape[-1])
                texts += [row.tobytes().decode("utf-8", "replace").strip(" \0") for row in rows]
        return [*texts, *[""] * count][:count]


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
    order, stated = _parameters(data)
    header = _Header._make(struct.unpack_from(f"{order}HHHHHfHHf", data, 2))
    samples = header.samples if header.samples and not header.analog % header.samples else 0
    count = header.analog // samples if samples else 0
    if not count and not header.points:
        raise UnfitError("recorder-file.no-channels", "neither")
    frames = _frames(header, stated)
    unsigned = "".join(stated.texts("ANALOG", "FORMAT", 1)).upper().startswith("UNSIGNED")
    stored = np.dtype(f"{order}{'f4' if header.scale < 0 else 'u2' if unsigned else 'i2'}")
    words = COORDINATES * header.points + header.analog
    # Held once as they are stored, and once as numbers of 8 bytes.
    require_small(8.0 * frames * (header.analog or 3 * header.points), label)
    begin = BLOCK * (header.data_block - 1)
    if begin < BLOCK or begin + frames * words * stored.itemsize > len(data):
        raise UnfitError("recorder-file.cut-off", CUT_OFF, expected=f"{frames} frames, as its header states")
    table = np.frombuffer(data, stored, frames * words, begin).reshape(frames, words)
    points, analog = np.split(table, [COORDINATES * header.points], axis=1)
    if not count:
        return Contents(_markers(points, stated, header))
    raw = analog.reshape(frames * samples, count).astype(np.float64)
    offsets = stated.numbers("ANALOG", "OFFSET", count, 0.0)
    offsets = np.where(unsigned & (offsets < 0), offsets + 2.0**16, offsets)
    scales = stated.numbers("ANALOG", "SCALE", count, 1.0) * stated.numbers("ANALOG", "GEN_SCALE", 1, 1.0)
    (rate,) = stated.numbers("ANALOG", "RATE", 1, header.rate * samples).tolist()
    clock = clock_of(rate, len(raw))
    labels, units = (stated.texts("ANALOG", name, count) for name in ("LABELS", "UNITS"))
    columns = zip(unique(labels, "analog"), ((raw - offsets) * scales).T, units, strict=True)
    return Contents({name: Channel(column, clock, unit) for name, column, unit in columns})


def _markers(table: np.ndarray, stated: _Parameters, header: _Header) -> dict[str, Channel]:
    """Each coordinate of each marker; no number where the cameras did not see it."""
    count = header.points
    (rate,) = stated.numbers("POINT", "RATE", 1, header.rate).tolist()
    clock = clock_of(rate, len(table))
    labels, (unit,) = stated.texts("POINT", "LABELS", count), stated.texts("POINT", "UNITS", 1)
    points = table.reshape(len(table), count, COORDINATES).astype(np.float64)
    # Programs write a gap as a residual below 0, or as the origin, where no marker is to the last digit.
    visible = (points[..., -1:] >= 0) & (points[..., :3] != 0).any(axis=-1, keepdims=True)
    places = np.where(visible, (1.0 if header.scale < 0 else header.scale) * points, np.nan)
    return {
        f"{name}.{letter}": Channel(places[:, number, axis], clock, unit)
        for number, name in enumerate(unique(labels, "marker"))
        for axis, letter in enumerate("xyz")
    }


def _frames(header: _Header, stated: _Parameters) -> int:
    """How many there are: the header's two bytes end at 65535, and longer files say more elsewhere."""
    first, last = header.first, header.last
    ends = [stated.get(("TRIAL", f"ACTUAL_{end}_FIELD"), np.empty(0)) for end in ("START", "END")]
    if all(end.size == 2 for end in ends):
        first, last = (int(end[0]) % 2**16 + 2**16 * (int(end[1]) % 2**16) for end in ends)
    if last < first:
        raise ValueError("a last frame before the first")
    return last - first + 1


def _parameters(data: bytes) -> tuple[str, _Parameters]:
    """The order of bytes, and the parameters."""
    at = BLOCK * (data[0] - 1)
    if data[0] < 1 or data[at + 3] not in _ORDERS:
        source = "one of a DEC computer" if data[at + 3] == 85 else "another kind of file"
        raise UnfitError("recorder-file.computer", source)
    order, end = _ORDERS[data[at + 3]], min(at + BLOCK * data[at + 2], len(data))
    groups: dict[int, str] = {}
    values: dict[tuple[int, str], np.ndarray] = {}
    at += 4
    while at < end:
        length, group = struct.unpack_from("bb", data, at)
        if not length:
            break
        step_at = at + 2 + abs(length)
        name = data[at + 2 : step_at].decode("latin-1").upper()
        (step,) = struct.unpack_from(f"{order}h", data, step_at)
        if group < 0:
            groups[-group] = name
        else:
            kind, dimensions = struct.unpack_from("bB", data, step_at + 2)
            shape = tuple(data[step_at + 4 : step_at + 4 + dimensions])
            # An unknown type is a KeyError: the file is damaged.
            stored, begin = f"{order}{_TYPES[kind]}", step_at + 4 + dimensions
            values[group, name] = np.frombuffer(data, stored, math.prod(shape), begin).reshape(shape[::-1])
        if step <= 0:
            break
        at = step_at + step
    return order, _Parameters({(groups.get(group, ""), name): v for (group, name), v in values.items()})
