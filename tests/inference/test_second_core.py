"""The second process: there early, gone afterwards, and missed by nobody where it can't be."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from bayestissue import runtime
from bayestissue.inference.execution.second_core import SecondCore, begun


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "compiled_folder", lambda: "somewhere")
    monkeypatch.setattr(runtime, "cores", lambda: 2)


def test_asking_for_it_imports_nothing_heavy() -> None:
    code = (
        "import sys, bayestissue.inference.execution.second_core as s; s.SecondCore();"
        "print(sorted({'numpy', 'jax', 'numpyro', 'pandas'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert found.stdout.strip() == "[]"


@pytest.mark.usefixtures("two_cores")
def test_a_process_that_was_started_does_what_is_begun_and_then_ends() -> None:
    with SecondCore() as core:
        core.start()
        pool = core.pool()
        core.start()
        assert core.pool() is pool
        other = core.begin(os.getpid)()
        assert other != os.getpid()
        np.testing.assert_array_equal(core.begin(np.add, np.arange(3), 1)(), [1, 2, 3])
    with pytest.raises(ProcessLookupError):
        os.kill(other, 0)


def test_without_it_whoever_asks_does_it_himself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "compiled_folder", lambda: None)
    with SecondCore() as core:
        core.start()
        assert core.pool() is None
        assert core.begin(os.getpid)() == os.getpid()


def test_a_broken_process_costs_time_only() -> None:
    class Broken:
        def submit(self, *_: object) -> None:
            raise RuntimeError("broken")

    assert begun(Broken(), os.getpid, ())() == os.getpid()
