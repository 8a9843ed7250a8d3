"""HDF5 files, ``.h5`` and ``.hdf5``, and the variables of MATLAB 7.3 files, which are HDF5 files too."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayestissue.recordings.dataset.formats.channel import Contents, of_arrays
from bayestissue.recordings.dataset.source_files import require_small

if TYPE_CHECKING:
    import h5py

SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read(data: bytes, label: str, *, of_matlab: bool = False) -> Contents:
    """A channel for every numeric vector, and for every column of a table [sample, channel].

    A vector is called by its path within the file, ``trial1/acceleration``, a column by the table's and its
    number from 1 on, ``trial1/force:3`` (see `columns`). The unit is the attribute ``units`` or ``unit`` of
    the dataset. ``of_matlab``, of version 7.3, fields are called ``test.daq.acc``, as in MATLAB.

    Raises:
        InputError: the datasets are too large once they are unpacked.
        OSError: the file is damaged.
    """
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        numeric = {
            name: item
            for name, item in _datasets(file)
            if item.dtype.kind in "fiu" and item.size and not (of_matlab and _is_other(name, item))
        }
        require_small(8.0 * sum(item.size for item in numeric.values()), label)
        if of_matlab:
            # MATLAB counts the dimensions from the other end.
            return of_arrays((name.replace("/", "."), item[()].T, "") for name, item in numeric.items())
        return of_arrays((name, item[()], _unit(item)) for name, item in numeric.items())


def _is_other(name: str, item: h5py.Dataset) -> bool:
    """Whether a dataset of MATLAB is no array of numbers: it keeps the shape of an empty one."""
    is_text = item.attrs.get("MATLAB_class", b"double") == b"char"
    return is_text or bool(item.attrs.get("MATLAB_empty", 0)) or name.startswith("#")


def _datasets(file: h5py.File) -> Iterator[tuple[str, Any]]:
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
            elif isinstance(item, h5py.Group):
                waiting.append((f"{before}{name}/", item))


def _unit(item: h5py.Dataset) -> str:
    unit = item.attrs.get("units", item.attrs.get("unit", ""))
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
    return unit if isinstance(unit, str) else ""
