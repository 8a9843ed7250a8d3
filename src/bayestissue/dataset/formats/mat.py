"""MATLAB's ``.mat`` files, versions 5 to 7.3: numeric vectors and columns of matrices are channels."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from bayestissue.dataset.files import require_small, unpacked_size
from bayestissue.dataset.formats import hdf5
from bayestissue.dataset.formats.channel import Contents, Format, of_arrays

# How numbers are kept, by the type of the data element.
_KEPT = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _NUMERIC, _OPAQUE = 2, range(6, 16), 17


def numeric_variables(data: bytes, label: str = "a .mat file") -> dict[str, np.ndarray]:
    """The real numeric arrays of a MATLAB 5 file that are not empty, by name, without dimensions of 1.

    A field of a structure is called as in MATLAB, ``test.daq.acc``, or ``trial(2).acc`` in an array of them.

    Args:
        data: the whole file.
        label: what to call it in a message.

    Raises:
        InputError: its variables are too large once they are unpacked.
        ValueError: the file is damaged, or is no MATLAB 5 file.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("neither a MATLAB 5 nor a MATLAB 7.3 file")
    arrays: dict[str, np.ndarray] = {}
    size = 0
    for kind, body in _elements(data[128:], order):
        if kind == _COMPRESSED:
            size = unpacked_size(body, label, before=size)
            ((kind, body),) = _elements(zlib.decompress(body), order)
        arrays.update(_arrays(kind, body, order))
    require_small(sum(8 * values.size for values in arrays.values()), label)
    return arrays


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """The data elements that ``data`` consists of: the type and the content of each."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        begin, end = at + 8, at + 8 + size
        step = size if kind == _COMPRESSED else -(-size // 8) * 8
        if kind >> 16:
            # A small element: its size shares a word with its type, its content fills the next one.
            kind, size = kind & 0xFFFF, kind >> 16
            begin, end, step = at + 4, at + 4 + size, 0
            if size > 4:
                raise ValueError("a small element larger than four bytes")
        if end > len(data) or (kind in _KEPT and size % int(_KEPT[kind][1])):
            raise ValueError("an element that is longer than the file, or not whole")
        if kind not in _KEPT and kind not in (_MATRIX, _COMPRESSED, 16, 17, 18):
            raise ValueError(f"an element of unknown type {kind}")
        yield kind, data[begin:end]
        at += 8 + step


def _arrays(kind: int, body: bytes, order: str, name: str | None = None) -> Iterator[tuple[str, np.ndarray]]:
    """The numeric arrays of a variable, which ``name`` calls where it is a field of a structure."""
    if kind != _MATRIX:
        raise ValueError(f"an element of type {kind} where a variable should be")
    parts = _elements(body, order)
    flags_kind, flags = next(parts, (0, b""))
    if flags_kind != 6 or len(flags) != 8:
        # MATLAB writes an empty field as a matrix without any part.
        if name is not None and not body:
            return
        raise ValueError("a variable without flags")
    word = struct.unpack(f"{order}II", flags)[0]
    variable_class, is_complex = word & 0xFF, bool(word & 0x800)
    if variable_class == _OPAQUE:
        return
    (shape_kind, shape), (name_kind, own_name) = next(parts, (0, b"")), next(parts, (0, b""))
    if shape_kind != 5 or len(shape) < 8 or name_kind != 1:
        raise ValueError("a variable without shape or name")
    lengths = struct.unpack(f"{order}{len(shape) // 4}i", shape)
    count = math.prod(lengths)
    name = own_name.decode("latin-1") if name is None else name
    if count < 1:
        return
    if variable_class == _STRUCT:
        yield from _fields(parts, order, name, count)
    if variable_class not in _NUMERIC or is_complex:
        return
    (values_kind, values), *more = list(parts)
    dtype = np.dtype(f"{order}{_KEPT.get(values_kind, 'V1')}")
    if more or dtype.kind == "V" or count * dtype.itemsize != len(values):
        raise ValueError("a variable whose values don't fill its shape")
    yield name, np.frombuffer(values, dtype).reshape(lengths, order="F").squeeze()


def _fields(
    parts: Iterator[tuple[int, bytes]], order: str, name: str, count: int
) -> Iterator[tuple[str, np.ndarray]]:
    """The numeric arrays in a structure, or in an array of ``count`` structures."""
    (length_kind, length), (names_kind, text) = next(parts, (0, b"")), next(parts, (0, b""))
    if length_kind != 5 or len(length) != 4 or names_kind != 1:
        raise ValueError("a structure without names of fields")
    width = struct.unpack(f"{order}i", length)[0]
    if not width > 0 or len(text) % width:
        raise ValueError("names of fields that don't fill their length")
    names = [text[at : at + width].split(b"\0")[0].decode("latin-1") for at in range(0, len(text), width)]
    for number, (kind, body) in enumerate(parts):
        which = f"({number // len(names) + 1})" if count > 1 else ""
        yield from _arrays(kind, body, order, f"{name}{which}.{names[number % len(names)]}")


def read(data: bytes, label: str) -> Contents:
    """The vectors, and the columns of matrices, by name; such files carry no clock and no units."""
    if data[512:520] == hdf5.SIGNATURE or data[:8] == hdf5.SIGNATURE:
        content = hdf5.variables(data, label)
    else:
        content = numeric_variables(data, label)
    return of_arrays((name, array, "") for name, array in content.items())


FORMAT = Format("MATLAB", ".mat", read)
