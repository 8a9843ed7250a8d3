"""HDF5 files, ``.h5`` and ``.hdf5``, and the variables of MATLAB 7.3 files, which are HDF5 files too."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

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
        numeric = _numeric(file, of_matlab=of_matlab)
        require_small(8.0 * sum(item.size for item in numeric.values()), label)
        if of_matlab:
            # MATLAB counts the dimensions from the other end.
            return of_arrays((name.replace("/", "."), item[()].T, "") for name, item in numeric.items())
        return of_arrays((name, item[()], _unit(item)) for name, item in numeric.items())


def _numeric(file: h5py.File, *, of_matlab: bool) -> dict[str, h5py.Dataset]:
    """The datasets of numbers that lie in the file itself: links and external storage lead to other files.

    Each is walked to once, those of outer groups first: groups may hold each other.
    """
    import h5py

    items: list[tuple[str, h5py.Group | h5py.Dataset]] = []
    file.visititems(lambda name, item: items.append((name, item)))
    numeric = {}
    for name, item in sorted(items, key=lambda named: named[0].count("/")):
        if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual:
            continue
        # MATLAB keeps text as numbers, the shape of an empty array, and what references lead to.
        if of_matlab and (
            name.startswith("#")
            or item.attrs.get("MATLAB_class", b"double") == b"char"
            or item.attrs.get("MATLAB_empty", 0)
        ):
            continue
        if item.dtype.kind in "fiu" and item.size:
            numeric[name] = item
    return numeric


def _unit(item: h5py.Dataset) -> str:
    unit = item.attrs.get("units", item.attrs.get("unit", ""))
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
    return unit if isinstance(unit, str) else ""
