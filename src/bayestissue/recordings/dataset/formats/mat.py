"""MATLAB's ``.mat`` files, versions 5 to 7.3: numeric vectors and columns of matrices are channels.

Files of version 5 are taken apart here: of 5,000 damaged ones scipy's reader ended the whole program at ten.
Source: MAT-File Format, The MathWorks (version 5: data elements, array flags, structures).
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from bayestissue.recordings.dataset.formats import hdf5
from bayestissue.recordings.dataset.formats.channel import Contents, of_arrays
from bayestissue.recordings.dataset.source_files import require_small

# How numbers are kept, by the type of the data element.
_KEPT = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _NUMERIC, _OPAQUE, _COMPLEX = 2, range(6, 16), 17, 0x800


def read(data: bytes, label: str) -> Contents:
    """The vectors, and the columns of matrices, by name; such files carry no clock and no units.

    A field of a structure is called as in MATLAB, ``test.daq.acc``, or ``trial(2).acc`` in an array of them.

    Raises:
        InputError: its variables are too large once they are unpacked.
        Exception: the file is damaged, or is no MATLAB file.
    """
    if hdf5.SIGNATURE in (data[:8], data[512:520]):
        return hdf5.read(data, label, of_matlab=True)
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("neither a MATLAB 5 nor a MATLAB 7.3 file")
    arrays = dict(entry for body in _elements(data[128:], order) for entry in _arrays(*body, order))
    require_small(8.0 * sum(array.size for array in arrays.values()), label)
    return of_arrays((name, array, "") for name, array in arrays.items())


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """The data elements that ``data`` consists of, unpacked: the type and the content of each."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        begin, end = at + 8, at + 8 + size
        at = end if kind == _COMPRESSED else begin + -(-size // 8) * 8
        if kind >> 16:
            # A small element: its size shares a word with its type, its content fills the next one.
            kind, size = kind & 0xFFFF, kind >> 16
            at, begin, end = begin, begin - 4, begin - 4 + size
        if end > min(at, len(data)):
            raise ValueError("an element that is longer than the file, or than its place")
        body = data[begin:end]
        yield from _elements(zlib.decompress(body), order) if kind == _COMPRESSED else [(kind, body)]


def _arrays(kind: int, body: bytes, order: str, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """The real numeric arrays of a variable that are not empty; ``name`` calls it where it is a field."""
    if kind != _MATRIX:
        raise ValueError(f"an element of type {kind} where a variable should be")
    if name and not body:
        # MATLAB writes an empty field as a matrix without any part.
        return
    (_, flags), *parts = _elements(body, order)
    (word, _) = struct.unpack(f"{order}II", flags)
    kind = word & 0xFF
    if kind == _OPAQUE:
        return
    (_, shape), (_, own_name), *content = parts
    lengths = struct.unpack(f"{order}{len(shape) // 4}i", shape)
    name, count = name or own_name.decode("latin-1"), math.prod(lengths)
    if kind == _STRUCT and count > 0:
        (_, length), (_, text), *fields = content
        (width,) = struct.unpack(f"{order}i", length)
        names = [text[at : at + width].split(b"\0")[0].decode("latin-1") for at in range(0, len(text), width)]
        for number, field in enumerate(fields):
            which = f"({number // len(names) + 1})" if count > 1 else ""
            yield from _arrays(*field, order, f"{name}{which}.{names[number % len(names)]}")
    elif kind in _NUMERIC and not word & _COMPLEX and count > 0:
        ((kind, values),) = content
        yield name, np.frombuffer(values, f"{order}{_KEPT[kind]}").reshape(lengths, order="F").squeeze()
