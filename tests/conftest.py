from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from bayestissue import runtime


def pytest_configure(config: pytest.Config) -> None:
    """Set up this process, whose tests are an entry point of their own: float64, compiled code kept.

    What one test has compiled serves the others, the suite's other worker, the programs that tests start, and
    the next run: all of it is kept in the folder that pytest keeps, unless another is named. A test that
    counts compilations, or wants none kept, names a folder of its own.
    """
    if config.option.markexpr == "not long":
        # Most of the default suite's time is the compiler's; a long test runs longer than it compiles.
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"
    if hasattr(config, "cache"):
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.cache.mkdir("compiled")))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
        runtime.keep_compiled()
    runtime.configure()


@pytest.fixture
def undrawn() -> Iterator[None]:
    """Figures of a test are made but not drawn."""
    from command_line import undrawn_figures

    with undrawn_figures():
        yield


@pytest.fixture(scope="session")
def heel_strikes() -> Path:
    """The recorded heel strikes, used where they lie beside the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "heelstrike"
    if not (folder / "dataset.toml").is_file():
        pytest.skip(f"the recorded heel strikes are not at {folder}")
    return folder
