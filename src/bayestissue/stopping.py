"""How a command ends when it is asked to stop."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from types import FrameType

from bayestissue import results

INTERRUPTED = 130
PATIENCE_S = 5.0
REMINDERS = 3

_insisting = threading.Event()


def on_request() -> None:
    """Make Ctrl-C and a polite kill raise KeyboardInterrupt, and see to it that the process then ends.

    An exception may be lost where Python can't pass it on (a callback of the garbage collector, a library
    that catches everything), or come late, behind a long compiled call. It is therefore raised again every
    `PATIENCE_S` seconds; after `REMINDERS` of them what was begun is cleared away and the process leaves.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    if not _insisting.is_set():
        _insisting.set()
        try:
            threading.Thread(target=_insist, daemon=True).start()
        except RuntimeError:
            # The interpreter is shutting down, and starts no thread any more: everything is done.
            return
    raise KeyboardInterrupt


def _insist() -> None:
    for _ in range(REMINDERS):
        time.sleep(PATIENCE_S)
        os.kill(os.getpid(), signal.SIGINT)
    results.discard_unfinished()
    sys.stderr.write("interrupted\n")
    sys.stderr.flush()
    os._exit(INTERRUPTED)
