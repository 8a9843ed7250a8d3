"""HDF5 files, ``.h5`` and ``.hdf5``, and the variables of MATLAB 7.3 files, which are HDF5 files too."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from bayestissue.dataset.files import require_small
from bayestissue.dataset.formats.channel import Channel, Contents, Format

if TYPE_CHECKING:
    import h5py

SIGNATURE = b"\x89HDF\r\n\x1a\n"
# A table of more columns is a picture or the like, and no recording of some channels.
_MOST_COLUMNS = 64


def read(data: bytes, label: str) -> Contents:
    """A channel for every numeric vector, and for every column of a table [sample, channel].

    A vector is called by its path within the file, ``trial1/acceleration``, a column by the table's and its
    number from 1 on, ``trial1/force:3``. The unit is the attribute ``units`` or ``unit`` of the dataset.

    Raises:
        InputError: the datasets are too large once they are unpacked.
        OSError: the file is damaged.
    """
    import h5py

    channels: dict[str, Channel] = {}
    with h5py.File(io.BytesIO(data), "r") as file:
        numeric = {name: item for name, item in _datasets(file) if item.dtype.kind in "fiu" and item.size}
        require_small(sum(8 * item.size for item in numeric.values()), label)
        for name, item in numeric.items():
            values, unit = np.asarray(item), _unit(item)
            if max(values.shape, default=1) == values.size:
                channels[name] = Channel(np.ravel(values).astype(np.float64), unit=unit)
            elif values.ndim == 2 and values.shape[1] <= _MOST_COLUMNS:
                for number, column in enumerate(values.T.astype(np.float64), 1):
                    channels[f"{name}:{number}"] = Channel(column, unit=unit)
    return Contents(channels)


def variables(data: bytes, label: str) -> dict[str, np.ndarray]:
    """The numeric arrays of a MATLAB 7.3 file, by name.

    Args:
        data: the whole file.
        label: what to call it in a message.

    Raises:
        InputError: its variables are too large once they are unpacked.
        OSError: the file is damaged.
    """
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        items = {
            name: item
            for name, item in _datasets(file, deep=False)
            if item.attrs.get("MATLAB_class", b"double") != b"char"
        }
        require_small(sum(item.nbytes for item in items.values()), label)
        return {name: np.asarray(item) for name, item in items.items()}


def _datasets(file: h5py.File, *, deep: bool = True) -> Iterator[tuple[str, Any]]:
    """The datasets whose numbers lie in the file itself: links and external storage lead to other files.

    Each comes once: a few groups that hold each other would otherwise have more paths than can be walked.
    """
    import h5py

    visited: set[int] = set()
    waiting = [("", file)]
    for before, group in waiting:
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            item = group[name]
            address = h5py.h5o.get_info(item.id).addr
            if address in visited:
                continue
            visited.add(address)
            if isinstance(item, h5py.Dataset) and not (item.external or item.is_virtual):
                yield f"{before}{name}", item
            elif deep and isinstance(item, h5py.Group):
                waiting.append((f"{before}{name}/", item))


def _unit(item: h5py.Dataset) -> str:
    unit = item.attrs.get("units", item.attrs.get("unit", ""))
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
    return unit if isinstance(unit, str) else ""


FORMATS = tuple(Format("HDF5", suffix, read) for suffix in (".h5", ".hdf5"))
