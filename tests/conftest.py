from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import made_once
from bayestissue.base import runtime

# Also the smallest: reading one takes a quarter of the time that compiling it does. JAX by itself would look
# through all of them whenever it keeps one more.
KEEP_ALL = {
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    "JAX_COMPILATION_CACHE_MAX_SIZE": "-1",
}
MOST_KEPT = 1_000_000_000
# Python by itself looks for garbage after every 700 new objects, and now and then through all that there are:
# with every module of the suite in memory, that took a tenth to a half of a test.
OBJECTS_BETWEEN_COLLECTIONS = 100_000
# Where in our code each operation stands costs a twentieth of a compilation, and nobody reads it here.
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")


def pytest_configure(config: pytest.Config) -> None:
    """Set up this process, whose tests are an entry point of their own: float64, compiled code kept.

    What one test has compiled serves the others, the suite's other worker, the programs that tests start, and
    the next run: all of it is kept in the folder that pytest keeps, unless another is named. A test that
    counts compilations, or wants none kept, names a folder of its own.
    """
    if "not long" in config.option.markexpr and "--xla_backend_opt" not in os.environ.get("XLA_FLAGS", ""):
        # Most of the suite's time is the compiler's; a long test runs longer than it compiles.
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"
    if hasattr(config, "cache"):
        kept = config.cache.mkdir("compiled")
        if not hasattr(config, "workerinput"):
            _empty_if_large(kept)
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(kept))
        for name, value in KEEP_ALL.items():
            os.environ.setdefault(name, value)
        runtime.keep_compiled()
    runtime.configure()
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    if hasattr(config, "workerinput"):
        # Both workers' temporary folders lie in one, which pytest removes in the end.
        made_once.keep_in(Path(config.option.basetemp).parent / "made-once")


def pytest_collection_finish() -> None:
    """Modules stay until the end: no collection looks through them again."""
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def few_mappings() -> Iterator[None]:
    """What modules have compiled is forgotten before it holds more mappings than the system allows."""
    yield
    runtime.release_compiled()


def _empty_if_large(folder: Path) -> None:
    entries = list(folder.iterdir())
    if sum(entry.stat().st_size for entry in entries) > MOST_KEPT:
        for entry in entries:
            entry.unlink()


@pytest.fixture(scope="session", autouse=True)
def few_motions_at_once() -> None:
    """Questions solve as many motions at once as a made-up run has draws, hundreds: a fit has thousands."""
    from bayestissue.inference.answers import law

    law.SETTINGS = replace(law.SETTINGS, together=256, loops_together=128)


@pytest.fixture(scope="module")
def read_once() -> Iterator[None]:
    """Of runs that are copies of one another a module's tests read the draws once."""
    from tree_file import read_once

    with read_once():
        yield


@pytest.fixture(scope="session")
def heel_strikes() -> Path:
    """The recorded heel strikes, used where they lie beside the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "heelstrike"
    if not (folder / "dataset.toml").is_file():
        pytest.skip(f"the recorded heel strikes are not at {folder}")
    return folder


@pytest.fixture(scope="session")
def shock_table() -> Path:
    """Recordings of a shock table, used where they lie beside the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "shock"
    if not list(folder.glob("*.lvm")):
        pytest.skip(f"the recordings of a shock table are not at {folder}")
    return folder
