"""The files of a result folder."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

# Of what HDF5 adds to the numbers themselves.
_MARGIN, _OVERHEAD = 1.05, 500_000


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write an indented JSON file as people read it."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_tree(tree: Any, path: Path) -> None:
    """Write an xarray DataTree as netCDF.

    Raises:
        OSError: it can't be written, the disk being full, say.
    """
    # HDF5 has been seen to end the process by a segmentation fault where the disk is full.
    require_room(path, int(_MARGIN * tree.nbytes) + _OVERHEAD)
    try:
        tree.to_netcdf(path, engine="h5netcdf")
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
