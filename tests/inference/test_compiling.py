"""What two processes share is what one would have done."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Event, Thread
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from bayestissue.inference.execution import ahead
from bayestissue.inference.execution.compiling import CHAINS, CHOICE, CORRECTION, Helper, in_pieces

PIECES = 8


class _Recording(Helper):
    """Does what it is asked for, and remembers how many rows that were."""

    def __init__(self) -> None:
        self.rows: list[int] = []

    def share(self, part: str, function: Any, given: Any, pieces: Sequence[Any]) -> list[Any]:
        self.rows += [len(piece[-1]) for piece in pieces]
        return super().share(part, function, given, pieces)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 50])
def test_the_pieces_are_the_whole(count: int) -> None:
    rows = jnp.arange(3.0 * count).reshape(count, 3)

    def function(factor: Any, rows: Any) -> dict[str, Any]:
        return {"sum": factor * rows.sum(1), "rows": rows}

    helper = _Recording()
    found = in_pieces(helper, "part", function, (2.0,), (rows,))
    np.testing.assert_array_equal(found["sum"], 2.0 * rows.sum(1))
    np.testing.assert_array_equal(found["rows"], rows)
    assert set(helper.rows) == {-(-count // PIECES)}


def _square(factor: float, value: float) -> float:
    return factor * value**2


class _Pool:
    """In place of a second process: a thread that breaks down after a number of pieces."""

    def __init__(self, lasts: int) -> None:
        self.left, self.done = lasts, 0
        self.compiled: list[tuple[str, bool]] = []
        self._threads = ThreadPoolExecutor(1)

    def submit(self, function: Any, *arguments: Any) -> Future:
        return self._threads.submit(self._do, function, arguments)

    def _do(self, function: Any, arguments: Any) -> Any:
        if function is ahead._compile:
            number, part, _, profiled = arguments
            self.compiled.append((part, profiled))
            ahead._COMPILED[number, part] = _square
            return None
        if self.done == self.left:
            raise RuntimeError("broken")
        self.done += 1
        return function(*arguments)


@pytest.fixture
def compiled_here(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, bool]]:
    """What this process compiles, by part and with a profile or not."""
    made: list[tuple[str, bool]] = []

    def lowered_functions(part: str, _: Any, *, profiled: bool) -> list[Any]:
        made.append((part, profiled))
        return []

    monkeypatch.setattr(ahead, "lowered_functions", lowered_functions)
    return made


@pytest.mark.usefixtures("compiled_here")
@pytest.mark.parametrize("lasts", [0, 2, 1000])
def test_a_worker_that_breaks_down_costs_no_piece(lasts: int) -> None:
    pool = _Pool(lasts)
    worker = ahead._Worker(pool, _job())
    worker.compile_ahead()
    values = [(float(k),) for k in range(40)]
    try:
        for _ in range(3):
            found = worker.share(CHOICE, _square, (2.0,), values)
            assert [float(each) for each in found] == [2.0 * k**2 for (k,) in values]
    finally:
        worker.close()
    assert pool.done <= lasts


def test_without_a_worker_all_is_done_here() -> None:
    worker = ahead._Worker(_Pool(1000), _job())
    assert worker.share(CHOICE, _square, (1.0,), [(2.0,), (3.0,)]) == [4.0, 9.0]
    worker.close()


@pytest.mark.parametrize("guess", [None, True, False])
def test_what_asks_for_a_profile_is_compiled_as_was_decided(
    guess: bool | None, compiled_here: list[tuple[str, bool]]
) -> None:
    pool = _Pool(1000)
    worker = ahead._Worker(pool, _job())
    worker.compile_ahead(profiled=guess)
    worker.decided(profiled=True)
    try:
        for part in ahead.PARTS:
            worker.wait(part)
        compiled = pool.compiled + compiled_here
        assert {(CHAINS, True), (CORRECTION, True)} <= set(compiled)
        assert {part for part, _ in compiled} == set(ahead.PARTS)
        # Another answer than the guess costs at most these two, and what was compiled here is looked up
        # there once more where the worker has its share.
        again = [part for part, _ in compiled_here if part in ahead.IN_PIECES]
        assert len(compiled) <= len(ahead.PARTS) + 2 * (guess is False) + len(again)
    finally:
        worker.close()


def test_whoever_waits_compiles_what_would_come_last(compiled_here: list[tuple[str, bool]]) -> None:
    pool = _Pool(1000)
    begun, goes_on = Event(), Event()
    plainly = pool._do

    def held(function: Any, arguments: Any) -> Any:
        begun.set()
        goes_on.wait()
        return plainly(function, arguments)

    pool._do = held  # type: ignore[method-assign]
    worker = ahead._Worker(pool, _job())
    worker.compile_ahead(profiled=False)
    begun.wait()
    waiting = Thread(target=worker.wait, args=(CHAINS,))
    waiting.start()
    try:
        while len(compiled_here) < len(ahead.PARTS) - 1:
            time.sleep(0.01)
        # The first is with the worker, and all others were done here, from the last one on, each once.
        assert [part for part, _ in compiled_here] == list(ahead.PARTS[:0:-1])
    finally:
        goes_on.set()
        waiting.join()
        worker.close()
    assert worker._parts[CHAINS].done()


def _job() -> Any:
    class Model:
        kind, weakly_identified = "impact", True

    return ahead.Job(Model(), None, None)  # type: ignore[arg-type]
