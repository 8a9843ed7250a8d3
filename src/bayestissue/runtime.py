"""How an entry point sets up the numerical libraries; importing the library itself changes nothing."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

LIBRARIES = ("bayestissue", "numpy", "scipy", "jax", "numpyro", "arviz", "pandas", "xarray")


def _allowed() -> tuple[int, ...]:
    return tuple(sorted(os.sched_getaffinity(0))) if hasattr(os, "sched_getaffinity") else ()


# What this process may use, remembered before it binds itself to one core.
CORES = _allowed()


def configure(*, one_core: bool = False) -> None:
    """Use float64; must be called before JAX computes anything.

    With ``one_core`` this process keeps to one of its cores. A compiled chain hands its many small pieces
    from thread to thread; on one core that costs nothing, and across cores that other work wants too it was
    measured to take eight times as long.
    """
    if one_core:
        _bind(CORES[os.getpid() % len(CORES)] if CORES else None)
    import jax

    jax.config.update("jax_enable_x64", True)


def settle(places: str, allowed: tuple[int, ...]) -> None:
    """Set up a worker process: bind it to a core that no other worker in ``places`` has taken, then as above.

    ``places`` is an existing folder; a file in it marks one of the ``allowed`` cores as taken.
    """
    for core in allowed:
        try:
            os.close(os.open(f"{places}/core-{core}", os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            continue
        _bind(core)
        break
    configure()


def _bind(core: int | None) -> None:
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})


def cores() -> int:
    """The number of processor cores this process may use."""
    return len(CORES) or os.cpu_count() or 1


def versions() -> dict[str, str]:
    """The versions that a result depends on, for `run.json`."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


def content_hash(paths: Iterable[Path]) -> str:
    """SHA-256 over the names and contents of ``paths``, whatever folder they lie in."""
    digest = hashlib.sha256()
    for path in sorted(paths, key=lambda path: path.name):
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
