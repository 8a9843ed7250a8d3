"""How an entry point sets up the numerical libraries; importing the library itself changes nothing."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

LIBRARIES = ("bayestissue", "numpy", "scipy", "jax", "numpyro", "arviz", "pandas", "xarray")


def configure(devices: int = 1) -> None:
    """Use float64, and offer JAX ``devices`` CPU devices so that chains can run side by side.

    Must be called before JAX computes anything: the number of devices is fixed by then.
    """
    import jax
    import numpyro

    numpyro.set_host_device_count(devices)
    jax.config.update("jax_enable_x64", True)


def cores() -> int:
    """The number of processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def versions() -> dict[str, str]:
    """The versions that a result depends on, for `run.json`."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


def content_hash(paths: Iterable[Path]) -> str:
    """SHA-256 over the names and contents of ``paths``, whatever folder they lie in."""
    digest = hashlib.sha256()
    for path in sorted(paths, key=lambda path: path.name):
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
