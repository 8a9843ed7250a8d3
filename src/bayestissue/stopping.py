"""How a command ends when it is asked to stop: at once, whatever it is doing.

An exception in the main thread would come late, behind a long compiled call, and may be lost on its way (in
an import, in a callback of the garbage collector, in a library that catches everything). So a thread of its
own ends the process: the main thread is held where it is, worker processes are killed, what was begun is
cleared away, and one line says what was kept.
"""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from contextlib import contextmanager

# As `bayestissue.errors.more` has it, which must not be imported when it is needed.
_MORE = "More: bayestissue explain interrupted"
# As `typing` has it, whose import takes as long as all these together.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType
    from typing import Any

INTERRUPTED = 130
# A step that must not be cut off lasts as long as two renames.
_PATIENCE_S = 5.0
# A terminal's cursor, which a bar of progress has hidden, on a new line.
_SHOW_CURSOR = "\x1b[?25h\n"
_REQUESTS = (signal.SIGINT, signal.SIGTERM)
# loky takes for a leak, and restarts with a warning, a process that has grown by 0.3 GB since its first task.
# A pool's first task is next to nothing: whatever is imported and compiled for the work itself comes later.
# All processes end with the work that they were begun for.
_NO_RECYCLING = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}

_step = threading.RLock()
_in_step: set[int] = set()
_asked = False
_at_the_end: list[Callable[[], str]] = []
_pools: list[Any] = []


def on_request() -> None:
    """From now on Ctrl-C and a polite kill end this process with status `INTERRUPTED`, until `done`."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # The operating system's own handler writes the signal's number here, whatever the interpreter is doing.
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_wait, args=(reader,), daemon=True).start()
    for number in _REQUESTS:
        signal.signal(number, _hold)


def done() -> None:
    """Everything is done and said: a request to stop changes nothing any more."""
    for number in _REQUESTS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def explained(end: Callable[[], str]) -> Iterator[None]:
    """For the length of a block, ``end`` is called on a request to stop; it says what was kept, if anything.

    It runs in another thread while the main thread is held anywhere, so it must import nothing and wait for
    nothing.
    """
    _at_the_end.append(end)
    try:
        yield
    finally:
        _at_the_end.remove(end)


@contextmanager
def ended_by(end: Callable[[], object]) -> Iterator[None]:
    """However the block ends, also on a request to stop, ``end`` is called, as of `explained`."""

    def silently() -> str:
        end()
        return ""

    with explained(silently):
        try:
            yield
        finally:
            end()


@contextmanager
def whole_step() -> Iterator[None]:
    """A block that a request to stop waits for; it must be short."""
    with _step:
        thread = threading.get_ident()
        first = thread not in _in_step
        _in_step.add(thread)
        try:
            yield
        finally:
            if first:
                _in_step.discard(thread)
    if first and _asked:
        _hold_here()


def begin_workers(
    function: Callable[[], Any],
    workers: int,
    initializer: Callable[..., None],
    initargs: tuple[Any, ...],
) -> Any:
    """A loky executor whose processes begin with a function, and end with this one or by `end_workers`.

    They leave a Ctrl-C, which a terminal sends to all processes, to this one.

    Args:
        function: the first thing that is asked for.
        workers: how many processes.
        initializer: what each of them does first, with ``initargs``.
        initargs: its arguments.
    """
    from loky import ProcessPoolExecutor

    _begin_trackers()
    first = (os.getpid(), initializer, initargs)
    pool = ProcessPoolExecutor(workers, initializer=_begin_worker, initargs=first, env=_NO_RECYCLING)
    _pools.append(pool)
    blocks = getattr(signal, "pthread_sigmask", None)
    before = blocks(signal.SIG_BLOCK, {signal.SIGINT}) if blocks else set()
    try:
        # A process that is not yet known as one of the pool could not be ended.
        with whole_step():
            pool.submit(function)
    finally:
        if blocks:
            blocks(signal.SIG_SETMASK, before)
    return pool


def _begin_worker(parent: int, initializer: Callable[..., None], initargs: tuple[Any, ...]) -> None:
    """In a worker process: end where the process that began it was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(INTERRUPTED)

    threading.Thread(target=watch, daemon=True).start()
    initializer(*initargs)


def _begin_trackers() -> None:
    """Processes that clear up after this one, and must not tell of it where this one was stopped.

    Python's own lets signals through again when it begins, so that must be before the workers do.
    """
    from multiprocessing import resource_tracker as of_python

    from loky.backend import resource_tracker

    before = os.environ.get("PYTHONWARNINGS")
    quiet = "ignore:resource_tracker:UserWarning"
    os.environ["PYTHONWARNINGS"] = quiet if before is None else f"{before},{quiet}"
    try:
        resource_tracker.ensure_running()
        of_python.ensure_running()
    finally:
        if before is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = before


def end_workers(pool: Any) -> None:
    """End the processes of `begin_workers`, whatever they are doing."""
    pool.shutdown(wait=True, kill_workers=True)
    _pools.remove(pool)


def interrupted(*saved: str) -> str:
    """What is said at such an end: what was kept, and where more stands."""
    return f"{'; '.join(['interrupted', *saved])}\n{_MORE}"


def _hold(number: int, frame: FrameType | None) -> None:
    """In the main thread: do nothing more, but for a step that has begun."""
    global _asked
    _asked = True
    if threading.get_ident() not in _in_step:
        _hold_here()


def _hold_here() -> None:
    threading.Event().wait()


def _wait(reader: int) -> None:
    while os.read(reader, 1)[0] not in _REQUESTS:
        pass
    _end()


def _end() -> None:
    # Collecting garbage runs anyone's code, which may wait for what the main thread holds.
    gc.disable()
    threading.excepthook = _say_nothing
    said = interrupted()
    try:
        _step.acquire(timeout=_PATIENCE_S)
        _kill_workers()
        saved = [words for end in reversed(_at_the_end) if (words := end())]
        said = interrupted(*saved)
    finally:
        try:
            os.write(2, f"{_SHOW_CURSOR if os.isatty(2) else ''}{said}\n".encode())
        finally:
            os._exit(INTERRUPTED)


def _say_nothing(_: Any) -> None:
    """Threads that miss their worker processes have nothing to tell."""


def _kill_workers() -> None:
    for pool in _pools:
        for pid in tuple(pool._processes or ()):
            try:
                os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))
            except OSError:
                continue
