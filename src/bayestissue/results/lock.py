"""One command at a time for each place of results."""

from __future__ import annotations

import errno
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from bayestissue import stopping
from bayestissue.errors import InputError, Problem

# A wish that can't be met on this machine whatever its state; a full disk, say, is none.
_NO_SUCH_PLACE = frozenset(
    {errno.ENOTDIR, errno.ENAMETOOLONG, errno.EACCES, errno.EPERM, errno.EROFS, errno.EINVAL}
    | {errno.EEXIST, errno.EISDIR, errno.ENOENT, errno.ELOOP}
)
_LONGEST = ".replaced-01234567"


@contextmanager
def making_parents(out: Path) -> Iterator[None]:
    """The folders above ``out`` are there in the block; those that this made are gone after it, if empty.

    Raises:
        InputError: they can't be made.
    """
    missing: list[Path] = []

    def end() -> str:
        for parent in missing:
            try:
                parent.rmdir()
            except OSError:
                break
        return ""

    with stopping.explained(end):
        try:
            with _said_of(out):
                missing += [parent for parent in out.parents if not parent.exists()]
                out.parent.mkdir(parents=True, exist_ok=True)
                # The longest name that is wanted beside it, tried before anything is computed.
                with suppress(FileNotFoundError):
                    (out.parent / f".{out.name}{_LONGEST}").lstat()
            yield
        finally:
            end()


@contextmanager
def locked(path: Path, out: Path) -> Iterator[None]:
    """A lock on ``out`` by the file ``path``, which is gone after the block; a dead process holds none.

    Raises:
        InputError: another process holds it, or ``path`` can't be made.
    """
    from filelock import FileLock, Timeout

    # A moment's patience, since a command that is just ending removes its file.
    lock = FileLock(path, timeout=0.2)

    def end() -> str:
        # Whoever waits for a file that is gone begins again with another, so it may go while it is locked.
        path.unlink(missing_ok=True)
        return ""

    try:
        with _said_of(out):
            lock.acquire()
    except Timeout:
        raise InputError(_in_use(out, path) if path.exists() else _no_place(out, "no such place")) from None
    with stopping.explained(end):
        try:
            with _said_of(out):
                now = f"{datetime.now().astimezone():%Y-%m-%d %H:%M}"
                path.write_text(f"process {os.getpid()} on {platform.node()} since {now}\n", encoding="utf-8")
            yield
        finally:
            end()
            lock.release()


def _in_use(out: Path, path: Path) -> Problem:
    try:
        words = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        words = ""
    return Problem(
        str(out),
        expected="a folder that no other command is writing",
        remedy="Wait for that one to end, or choose another --out.",
        value=f"a folder in use by {words or 'another command'}",
        code="out-in-use",
    )


@contextmanager
def _said_of(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in _NO_SUCH_PLACE:
            raise
        raise InputError(_no_place(out, error.strerror or str(error))) from error


def _no_place(out: Path, why: str) -> Problem:
    file, remedy = _file_above(out), "Choose another --out."
    if file is not None:
        return Problem(
            str(out), f"a folder at {file}", remedy, value="a file above it", code="out-unwritable"
        )
    return Problem(
        str(out), "a folder that can be made and written", remedy, value=why, code="out-unwritable"
    )


def _file_above(out: Path) -> Path | None:
    for parent in out.parents:
        with suppress(OSError):
            if parent.exists() and not parent.is_dir():
                return parent
    return None
