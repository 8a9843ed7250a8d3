"""How an entry point sets up the numerical libraries; importing the library itself changes nothing."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

LIBRARIES = ("bayestissue", "numpy", "scipy", "jax", "numpyro", "arviz", "pandas", "xarray")


def configure() -> None:
    """Use float64; must be called before JAX computes anything."""
    import jax

    jax.config.update("jax_enable_x64", True)


def settle(places: str) -> None:
    """Set up a worker process: bind it to a core that no other worker in ``places`` has taken, then as above.

    ``places`` is an existing folder; a file in it marks a core as taken.
    """
    if hasattr(os, "sched_setaffinity"):
        for core in sorted(os.sched_getaffinity(0)):
            try:
                os.close(os.open(f"{places}/core-{core}", os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                continue
            os.sched_setaffinity(0, {core})
            break
    configure()


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
