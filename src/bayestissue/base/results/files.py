"""The files of a result folder: JSON and netCDF, each whole under its name or not there."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

# Of what HDF5 adds to the numbers themselves.
_MARGIN, _OVERHEAD = 1.05, 500_000
# Of single precision alone: double precision is little smaller when packed, and takes twice as long.
_PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write an indented JSON file as people read it."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_tree(tree: Any, path: Path) -> None:
    """Write an xarray DataTree as netCDF; what has less than double precision, predictions say, is packed.

    netCDF-4 is HDF5 with scales for dimensions. h5py writes the 266 variables of a fit in a fifth of the time
    that xarray takes, which looks each of them up fifty times and imports what Dask computes with.

    Raises:
        OSError: it can't be written, the disk being full, say.
    """
    import h5py

    # HDF5 has been seen to end the process by a segmentation fault where the disk is full.
    require_room(path, int(_MARGIN * tree.nbytes) + _OVERHEAD)
    try:
        with h5py.File(path, "w", track_order=True) as file:
            for part in tree.subtree:
                group = file if part.path == "/" else file.create_group(part.path, track_order=True)
                _write_group(part.to_dataset(), group)
    except RuntimeError as error:
        # What HDF5 raises where it notices on closing.
        raise OSError(errno.EIO, f"can't be written: {error}", str(path)) from error


def _write_group(dataset: Any, group: Any) -> None:
    import h5py
    from xarray.conventions import encode_dataset_coordinates

    # Coordinates that are no dimension's are named in attributes.
    variables, attributes = encode_dataset_coordinates(dataset)
    group.attrs.update(attributes)
    for name, size in dataset.sizes.items():
        if name not in dataset.variables:
            words = f"This is a netCDF dimension but not a netCDF variable.{size:10d}"
            group.create_dataset(name, (size,), ">f4").make_scale(words)
    # Coordinates first: they are the scales of what follows.
    for name in (*dataset.coords, *dataset.data_vars):
        variable = variables[name]
        values = variable.to_numpy()
        kind = h5py.string_dtype() if values.dtype.kind in "OU" else values.dtype
        packing = _PACKED if kind == "float32" else {}
        stored = group.create_dataset(name, data=values.astype(kind, copy=False), dtype=kind, **packing)
        stored.attrs.update(variable.attrs)
        if values.dtype.kind == "f":
            stored.attrs.create("_FillValue", float("nan"), (1,), values.dtype)
        if name in dataset.dims:
            stored.make_scale(name)
            continue
        for axis, dimension in enumerate(variable.dims):
            stored.dims[axis].attach_scale(group[dimension])


def require_room(path: Path, size: int) -> None:
    """Raise an OSError unless a file of so many bytes can be written at ``path``, where there is none yet."""
    if not hasattr(os, "posix_fallocate"):
        if shutil.disk_usage(path.parent).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return
    try:
        with path.open("xb") as file:
            os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        error.filename = str(path)
        raise
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path that takes the name ``path`` when the block ends without an error."""
    path = Path(path).absolute()
    path.parent.mkdir(parents=True, exist_ok=True)
    staging = path.parent / f".{path.name}.partial-{secrets.token_hex(4)}{path.suffix}"
    try:
        os.close(os.open(staging, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644))
        yield staging
        put(staging, path)
    finally:
        remove(staging)


def put(staging: Path, path: Path) -> None:
    """Give a file its name; a power cut leaves what had the name before, or all of the file.

    Its bytes are on the disk before it takes the name, and the name is on the disk when this ends.

    Raises:
        OSError: it can't be written; what had the name still has it.
    """
    with staging.open("rb+") as file:
        os.fsync(file.fileno())
    staging.replace(path)
    # The folder itself may be new too.
    for folder in (path.parent, path.parent.parent):
        sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk, where the system knows such a thing."""
    if hasattr(os, "O_DIRECTORY"):
        with suppress(OSError):
            opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(opened)
            finally:
                os.close(opened)


def file_sha256(path: Path) -> str:
    """The SHA-256 digest of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove(path: Path) -> None:
    """Remove a file, a link or a folder with all that it holds, if it is there and this can be done."""
    shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):
        path.unlink()
