"""Files of draws for tests, written and read at less than xarray's second each.

Most of that goes into variables, of which a fit's file has nearly two hundred, and not into numbers.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import pytest
import xarray as xr

from made_once import once

_NUMBERS = "fiu"


def write_tree(groups: Mapping[str, xr.Dataset], path: Path) -> None:
    """Write a file as xarray does: one of the same variables is copied, and gets these numbers."""
    key = sha256(repr([(name, _outline(data)) for name, data in groups.items()]).encode()).hexdigest()[:16]

    def write(file: Path) -> None:
        xr.DataTree.from_dict(dict(groups)).to_netcdf(file, engine="h5netcdf")

    shutil.copyfile(once(f"tree-{key}.nc", write), path)
    with h5py.File(path, "r+") as file:
        for group, data in groups.items():
            for name, variable in data.variables.items():
                if variable.dtype.kind in _NUMBERS:
                    file[group][str(name)][...] = variable.to_numpy()


def _outline(data: xr.Dataset) -> list[Any]:
    """All that a file has of a group but its numbers."""
    return [dict(data.attrs)] + [
        (name, v.dims, v.shape, v.dtype.str, v.attrs, v.encoding)
        + (() if v.dtype.kind in _NUMBERS else (v.to_numpy().tolist(),))
        for name, v in data.variables.items()
    ]


@contextmanager
def read_once() -> Iterator[None]:
    """Files of the same bytes are read once, whole or a group; who asks gets a copy in memory."""
    kept: dict[tuple[Any, ...], Any] = {}

    def once_of(read: Callable[..., Any]) -> Callable[..., Any]:
        def copy(path: Path, **options: str) -> Any:
            key = sha256(Path(path).read_bytes()).hexdigest(), *options.items()
            if key not in kept:
                with read(path, **options) as stored:
                    kept[key] = stored.load()
            return kept[key].copy(deep=True)

        return copy

    with pytest.MonkeyPatch.context() as patch:
        for name in ("open_dataset", "open_datatree"):
            patch.setattr(xr, name, once_of(getattr(xr, name)))
        yield
