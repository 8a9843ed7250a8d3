"""The files of a result folder."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write an indented JSON file as people read it."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_tree(tree: Any, path: Path) -> None:
    """Write an xarray DataTree as netCDF.

    Raises:
        OSError: it can't be written, the disk being full, say.
    """
    try:
        tree.to_netcdf(path, engine="h5netcdf")
    except RuntimeError as error:
        # What HDF5 raises where it notices on closing.
        raise OSError(errno.EIO, f"can't be written: {error}", str(path)) from error
