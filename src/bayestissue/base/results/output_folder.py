"""Where results go: a folder that one command at a time writes, whole, and without losing what was there."""

from __future__ import annotations

import errno
import os
import platform
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from bayestissue.base.errors import InputError
from bayestissue.base.results.files import remove
from bayestissue.base.results.manifest import (
    MANIFEST,
    discard,
    foreign,
    mark_unfinished,
    require_free,
    require_left_over,
    require_place,
    write_manifest,
)

# A wish that can't be met on this machine whatever its state; a full disk, say, is none.
_NO_SUCH_PLACE = frozenset(
    {errno.ENOTDIR, errno.ENAMETOOLONG, errno.EACCES, errno.EPERM, errno.EROFS, errno.EINVAL}
    | {errno.EEXIST, errno.EISDIR, errno.ENOENT, errno.ELOOP}
)
_LOCK = re.compile(r"process \d+ on .* since [\d :-]+")
GO_ON = "run the same command again to go on from here"


@dataclass(frozen=True)
class OutputFolder:
    """A claimed folder for results; see `claim`.

    Attributes:
        path: where the results go, as the user named it.
        target: where that leads.
        command: what writes the results.
        overwrite: replace what is there, if all of that is this program's own.
    """

    path: Path
    target: Path
    command: str
    overwrite: bool

    @contextmanager
    def folder(self) -> Iterator[Path]:
        """A staging folder that takes the place when the block ends, and vanishes if it fails.

        It lies beside the place, so that the last step is a rename on one file system.

        Raises:
            InputError: something has taken the place meanwhile.
        """
        staging = _hidden(self.target, "partial")
        try:
            _begin_job(staging)
            yield staging
            write_manifest(staging, self.command)
            staging.chmod(0o755)
            require_free(self.target, overwrite=self.overwrite)
            _replace(self.target, staging)
        except OSError as error:
            # A write that fails does not say where.
            error.filename = error.filename or str(self.path)
            raise
        finally:
            remove(staging)

    @contextmanager
    def unfinished(self, job: str) -> Iterator[Path]:
        """A folder beside the place for the finished parts of a ``job``, gone when the block ends well.

        Where it does not, parts stay for the next run of the same job. Those of other jobs are discarded.

        Args:
            job: a fingerprint of everything that the parts depend on, by which their folder is named.
        """
        parts = _hidden(self.target, "unfinished")
        folder = parts / job[:32]
        if not (parts / MANIFEST).is_file():
            with suppress(FileNotFoundError):
                parts.rmdir()
            _begin_job(parts)
        for entry in parts.iterdir():
            if entry.is_symlink() or entry not in {folder, parts / MANIFEST}:
                remove(entry)
        # Of a process that was killed while it wrote one.
        for half in folder.rglob(".*.partial-*"):
            remove(half)
        try:
            folder.mkdir(exist_ok=True)
            yield folder
        except BaseException as error:
            if any(path.is_file() for path in folder.rglob("*")):
                error.add_note(GO_ON)
            else:
                discard(parts)
            raise
        discard(parts)


@contextmanager
def claim(
    out: Path, *, overwrite: bool = False, command: str, inputs: Sequence[str | Path | None] = ()
) -> Iterator[OutputFolder]:
    """The folder ``out`` for one command's results, refused to all others until the block ends.

    Args:
        out: a folder that is new or empty; with ``overwrite``, also one that this program wrote.
        overwrite: replace what ``out`` holds, if all of that is this program's own.
        command: what writes the results.
        inputs: files and folders that the command reads; nothing that holds one is replaced.

    Raises:
        InputError: ``out`` would lose something, can't be made, or another command is writing it; or what it
            needs beside it is a link, or a person's own.
    """
    with locked_folder(out, inputs) as target:
        partial, replaced = _hidden(target, "partial"), _hidden(target, "replaced")
        for left in (partial, replaced, _hidden(target, "unfinished")):
            require_left_over(left)
        discard(partial)
        if not target.exists() and replaced.exists() and not foreign(replaced):
            # A command was killed between two renames.
            replaced.rename(target)
        discard(replaced)
        require_free(target, overwrite=overwrite)
        yield OutputFolder(Path(out), target, command, overwrite)


def _begin_job(folder: Path) -> None:
    folder.mkdir(mode=0o700)
    mark_unfinished(folder)


def _replace(out: Path, new: Path) -> None:
    """Give the folder ``new`` the name ``out``; what had it steps aside first, and back if that fails."""
    replaced = _hidden(out, "replaced")
    try:
        if out.exists():
            out.rename(replaced)
        new.rename(out)
    except BaseException:
        if replaced.exists() and not out.exists():
            replaced.rename(out)
        raise
    if replaced.exists():
        mark_unfinished(replaced)
        discard(replaced)


@contextmanager
def locked_folder(out: Path, inputs: Sequence[str | Path | None]) -> Iterator[Path]:
    """Where ``out`` leads, which one process at a time writes: refused to all others until the block ends.

    The folders above it are made; those that are empty afterwards are gone again.

    Raises:
        InputError: it can't be made, or another command is writing it.
    """
    target = require_place(out, inputs)
    missing: list[Path] = []
    try:
        with _as_input_errors(target):
            missing += [parent for parent in target.parents if not parent.exists()]
            target.parent.mkdir(parents=True, exist_ok=True)
            # The longest name that is wanted beside it, tried before anything is computed.
            with suppress(FileNotFoundError):
                _hidden(target, "unfinished").lstat()
        with locked(target):
            yield target
    finally:
        with suppress(OSError):
            for parent in missing:
                parent.rmdir()


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """A lock on ``out`` by a file beside it, which is gone after the block; a dead process holds none.

    Raises:
        InputError: another process holds it, or the file can't be made.
    """
    from filelock import FileLock, Timeout

    path = _hidden(out.resolve(), "lock")
    if path.is_symlink() or (_text_of(path) and not _LOCK.fullmatch(_text_of(path))):
        require_left_over(path)
    # A moment's patience, since a command that is just ending removes its file.
    lock = FileLock(path, timeout=0.2)
    try:
        with _as_input_errors(out):
            lock.acquire()
            now = f"{datetime.now().astimezone():%Y-%m-%d %H:%M}"
            path.write_text(f"process {os.getpid()} on {platform.node()} since {now}\n", encoding="utf-8")
        yield
    except Timeout:
        if not path.exists():
            raise InputError.stated("out-unwritable.here", str(out), value="no such place") from None
        value = f"a folder in use by {_text_of(path) or 'another command'}"
        raise InputError.stated("out-in-use", str(out), value=value) from None
    finally:
        if lock.is_locked:
            # Whoever waits for a file that is gone begins again with another, so it may go while locked.
            path.unlink(missing_ok=True)
        lock.release()


def _text_of(path: Path) -> str:
    try:
        return path.read_bytes().decode(errors="replace").strip()
    except OSError:
        return ""


@contextmanager
def _as_input_errors(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in _NO_SUCH_PLACE:
            raise
        for parent in out.parents:
            with suppress(OSError):
                if parent.exists() and not parent.is_dir():
                    raise InputError.stated(
                        "out-unwritable.above", str(out), value="a file above it", path=parent
                    ) from error
        value = error.strerror or str(error)
        raise InputError.stated("out-unwritable.here", str(out), value=value) from error


def _hidden(out: Path, kind: str) -> Path:
    return out.parent / f".{out.name}.{kind}"
