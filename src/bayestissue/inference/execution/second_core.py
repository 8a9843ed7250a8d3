"""A process on another core, there before anything that is asked of it is known.

It takes seconds to import what a fit needs, and so begins while this process still imports that too: nothing
here does.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any

from bayestissue import runtime, stopping


class SecondCore:
    """For as many fits as are made within it; begun when it is first asked for, or by `start`."""

    def __init__(self) -> None:
        self._pool: Any = None

    def start(self) -> None:
        """Let the process begin, where there is a second core and a folder for what is compiled."""
        if self._pool is not None or not runtime.compiled_folder() or runtime.cores() < 2:
            return
        own = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
        others = tuple(core for core in runtime.CORES if core not in own) or runtime.CORES
        # Compiled functions that are kept would pass for a leak of memory, and the worker be replaced.
        kept = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}
        core = others[0] if others else None
        self._pool = stopping.begin_workers(
            _ready, 1, initializer=runtime.settle_on, initargs=(core,), env=kept
        )

    def pool(self) -> Any:
        """The process; None without a second core or a folder for what is compiled, or on an accelerator."""
        import jax

        if jax.default_backend() != "cpu":
            return None
        self.start()
        return self._pool

    def begin(self, function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
        """Begin any function there, or leave it to whoever asks what is returned for its result."""
        pool = self.pool()
        return partial(function, *arguments) if pool is None else begun(pool, function, arguments)

    def __enter__(self) -> SecondCore:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            stopping.end_workers(self._pool)


def submitted(pool: Any, function: Callable[..., Any], *arguments: Any) -> Future:
    """What is submitted, or the error of that: a broken process costs time only."""
    try:
        return pool.submit(function, *arguments)
    except Exception as error:
        failed: Future = Future()
        failed.set_exception(error)
        return failed


def begun(pool: Any, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Callable[[], Any]:
    """The result of a function that the process has begun, or this one then does itself."""
    import jax
    import numpy as np

    sent = [np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf for leaf in jax.tree.leaves(arguments)]
    future = submitted(pool, function, *jax.tree.unflatten(jax.tree.structure(arguments), sent))

    def result() -> Any:
        return function(*arguments) if future.exception() is not None else future.result()

    return result


def _ready() -> None:
    """A process that is asked for it has started and imported what a fit needs."""
    import bayestissue.inference.execution.ahead  # noqa: F401
