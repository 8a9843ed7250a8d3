"""How a command ends when it is asked to stop: by a KeyboardInterrupt, and at once by a second request."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

# As `typing` has it, whose import takes as long as all these together.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType
    from typing import Any

INTERRUPTED = 130
# As `bayestissue.base.errors.more` has it, which must not be imported when it is needed.
_MORE = "More: bayestissue explain interrupted"
_REQUESTS = (signal.SIGINT, signal.SIGTERM)
# Some programs send two signals for one request, as `timeout` does.
_ONE_REQUEST_S = 1.0
_BEHIND_S, _AGAIN = 0.1, 5
# A terminal's cursor, which a bar of progress has hidden, on a new line.
_SHOW_CURSOR = b"\x1b[?25h\n"
# A list, since a second signal may come while the first one's handler runs, which a lock would wait for.
_received: list[int] = []


def on_request() -> None:
    """From now on, until `done`, Ctrl-C and a polite kill raise a KeyboardInterrupt, and the second ends all.

    A compiled call lets an exception through when it ends, and an import is let end. A thread of its own
    waits for the second request.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # The operating system's own handler writes here, whatever the interpreter is doing.
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_end_at_the_second, args=(reader,), daemon=True).start()
    for number in _REQUESTS:
        signal.signal(number, _interrupt)


def done() -> None:
    """Everything is done and said: a request to stop changes nothing any more."""
    for number in _REQUESTS:
        signal.signal(number, signal.SIG_IGN)


def requested() -> bool:
    """Whether this process was asked to stop: a library may have made another exception of that."""
    return bool(_received)


def interrupted(*results: str) -> str:
    """What is said at such an end: what was kept, and where more stands."""
    return f"{'; '.join(['interrupted', *results])}\n{_MORE}"


def _interrupt(number: int, frame: FrameType | None) -> None:
    if not _received:
        _received.append(number)
        # Libraries and threads would show what stopped them.
        sys.excepthook = lambda *_: None
        threading.excepthook = lambda _: None
        sys.unraisablehook = _raise_again
        importer = _importer(frame)
        if importer is None:
            raise KeyboardInterrupt
        # The interpreter calls the function of a traced frame when it goes on there.
        importer.f_trace = _raise
        sys.settrace(lambda *_: None)


def _importer(frame: FrameType | None) -> FrameType | None:
    """What imports something just now: a library half imported loses what is raised in it, or aborts."""
    importer, importing = None, False
    while frame is not None:
        is_import = frame.f_code.co_filename.startswith("<frozen importlib.")
        if importing and not is_import:
            importer = frame
        importing, frame = is_import, frame.f_back
    return importer


def _raise(*_: Any) -> None:
    raise KeyboardInterrupt


def _raise_again(lost: Any) -> None:
    """An exception in a callback, as of the garbage collector, reaches no one; so once more, behind it."""
    if lost.exc_type is KeyboardInterrupt:
        import ctypes

        thread, error = ctypes.c_ulong(threading.main_thread().ident or 0), ctypes.py_object(lost.exc_type)
        threading.Timer(_BEHIND_S, ctypes.pythonapi.PyThreadState_SetAsyncExc, (thread, error)).start()


def _end_at_the_second(reader: int) -> None:
    os.read(reader, 1)
    first = time.monotonic()
    # A wait that had all but begun when it came goes on: it is interrupted by another one.
    for _ in range(_AGAIN):
        time.sleep(_BEHIND_S)
        if not _received:
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    while os.read(reader, 1) and time.monotonic() - first < _ONE_REQUEST_S:
        continue
    os.write(2, _SHOW_CURSOR if os.isatty(2) else b"")
    os._exit(INTERRUPTED)
