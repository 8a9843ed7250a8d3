"""MATLAB's ``.mat`` files, versions 5 to 7.3: every numeric vector is a channel."""

from __future__ import annotations

import io
import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from bayestissue.dataset.files import unpacked_size
from bayestissue.dataset.formats import hdf5
from bayestissue.dataset.formats.channel import Channel, Contents, Format

_ITEM_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
_MATRIX, _COMPRESSED = 14, 15
_NUMERIC_CLASSES = range(6, 16)
_OPAQUE = 17


def numeric_variables(data: bytes, label: str = "a .mat file") -> dict[str, np.ndarray]:
    """The real numeric arrays of a MATLAB 5 file, by name.

    Args:
        data: the whole file.
        label: what to call it in a message.

    Raises:
        InputError: its variables are too large once they are unpacked.
        ValueError: the file is damaged, or is no MATLAB 5 file.
    """
    from scipy.io import loadmat

    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("neither a MATLAB 5 nor a MATLAB 7.3 file")
    names: list[str] = []
    size = 0
    for kind, body in _elements(data[128:], order):
        if kind == _COMPRESSED:
            size = unpacked_size(body, label, before=size)
            ((kind, body),) = _elements(zlib.decompress(body), order)
        names += _numeric_name(kind, body, order)
    content = loadmat(io.BytesIO(data), squeeze_me=True, variable_names=names)
    return {name: np.asarray(content[name]) for name in names}


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
        if end > len(data) or (kind in _ITEM_BYTES and size % _ITEM_BYTES[kind]):
            raise ValueError("an element that is longer than the file, or not whole")
        if kind not in _ITEM_BYTES and kind not in (_MATRIX, _COMPRESSED, 16, 17, 18):
            raise ValueError(f"an element of unknown type {kind}")
        yield kind, data[begin:end]
        at += 8 + step


def _numeric_name(kind: int, body: bytes, order: str) -> Iterator[str]:
    if kind != _MATRIX:
        raise ValueError(f"an element of type {kind} where a variable should be")
    parts = _elements(body, order)
    flags_kind, flags = next(parts, (0, b""))
    if flags_kind != 6 or len(flags) != 8:
        raise ValueError("a variable without flags")
    word = struct.unpack(f"{order}II", flags)[0]
    variable_class, is_complex = word & 0xFF, bool(word & 0x800)
    if variable_class == _OPAQUE:
        return
    (shape_kind, shape), (name_kind, name) = next(parts, (0, b"")), next(parts, (0, b""))
    if shape_kind != 5 or len(shape) < 8 or name_kind != 1:
        raise ValueError("a variable without shape or name")
    count = math.prod(struct.unpack(f"{order}{len(shape) // 4}i", shape))
    if variable_class not in _NUMERIC_CLASSES or is_complex:
        return
    (values_kind, values), *more = list(parts)
    if more or count * _ITEM_BYTES.get(values_kind, 0) != len(values) or count < 1:
        raise ValueError("a variable whose values don't fill its shape")
    yield name.decode("latin-1")


def read(data: bytes, label: str) -> Contents:
    """The vectors by name; such files carry no clock and no units."""
    if data[512:520] == hdf5.SIGNATURE or data[:8] == hdf5.SIGNATURE:
        content = hdf5.variables(data, label)
    else:
        content = numeric_variables(data, label)
    return Contents(
        {
            name: Channel(np.ravel(values).astype(np.float64))
            for name, values in content.items()
            if isinstance(values, np.ndarray)
            and values.dtype.kind in "fiu"
            and max(values.shape, default=0) == values.size
        }
    )


FORMAT = Format("MATLAB", ".mat", read)
