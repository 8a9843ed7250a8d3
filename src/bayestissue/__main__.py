"""The command ``bayestissue``, also ``python -m bayestissue``: it can be stopped from its first moment on."""

from __future__ import annotations

import gc
import os

from bayestissue.base import stopping

# As `typing` has it, whose import takes as long as all these together.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator


def main() -> None:
    """Run the command line; where it was asked to stop, say what was kept, and end without further ado."""
    stopping.on_request()
    # Of what is imported and traced most stays. Looked through after each 700 new objects, as Python does
    # unless told, and once more at the end, it takes a fit 2.5 s.
    gc.set_threshold(100_000)
    try:
        from bayestissue.cli import main as command_line

        command_line()
    except BaseException as error:
        done = isinstance(error, SystemExit) and not error.code
        if done or not stopping.requested():
            raise
        os.write(2, f"{stopping.interrupted(*dict.fromkeys(_notes(error)))}\n".encode(errors="replace"))
        # Threads that compute, and libraries, would hold up an end in good order.
        os._exit(stopping.INTERRUPTED)
    finally:
        stopping.done()
        gc.freeze()


def _notes(error: BaseException | None) -> Iterator[str]:
    """Those of an error, and of what it came of."""
    while error is not None:
        yield from getattr(error, "__notes__", ())
        error = error.__cause__ or error.__context__


if __name__ == "__main__":
    main()
