"""Draws of stored runs: few, packed, and read at less than xarray's second each."""

from __future__ import annotations

import tarfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr


def pack(folder: Path, stored: Path) -> None:
    """Store the files of a run."""
    with tarfile.open(stored, "w:xz") as packed:
        for path in sorted(folder.iterdir()):
            packed.add(path, path.name)


def unpack(stored: Path, folder: Path) -> Path:
    with tarfile.open(stored) as packed:
        packed.extractall(folder, filter="data")
    return folder


def single_precision(array: xr.DataArray) -> xr.DataArray:
    """The same with half of the digits, which take a third of the room."""
    return array.astype(np.float32).astype(float) if array.dtype == np.float64 else array


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
