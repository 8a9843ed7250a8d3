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


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write an indented JSON file as people read it."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_tree(tree: Any, path: Path) -> None:
    """Write an xarray DataTree as netCDF; what has less than double precision, predictions say, is packed.

    Raises:
        OSError: it can't be written, the disk being full, say.
    """
    # Single precision alone: double precision is little smaller when packed, and takes twice as long.
    packing = {
        group.path: {
            name: {"compression": "gzip", "compression_opts": 1, "shuffle": True}
            for name, variable in group.data_vars.items()
            if variable.dtype == "float32"
        }
        for group in tree.subtree
    }
    # HDF5 has been seen to end the process by a segmentation fault where the disk is full.
    require_room(path, int(_MARGIN * tree.nbytes) + _OVERHEAD)
    try:
        tree.to_netcdf(path, engine="h5netcdf", encoding=packing)
    except RuntimeError as error:
        # What HDF5 raises where it notices on closing.
        raise OSError(errno.EIO, f"can't be written: {error}", str(path)) from error


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
    try:
        path.unlink(missing_ok=True)
    except OSError:
        return
