"""Where results go: a folder that one command at a time writes, whole, and without losing what was there."""

from __future__ import annotations

import errno
import os
import platform
import re
import secrets
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path

from bayestissue import stopping
from bayestissue.errors import InputError, PartialResultError, Problem, printable
from bayestissue.results.files import passing, remove
from bayestissue.results.mark import (
    MARK,
    discard,
    is_left_over,
    require_free,
    require_left_over,
    require_place,
    start_job,
    write_mark,
)

# A wish that can't be met on this machine whatever its state; a full disk, say, is none.
_NO_SUCH_PLACE = frozenset(
    {errno.ENOTDIR, errno.ENAMETOOLONG, errno.EACCES, errno.EPERM, errno.EROFS, errno.EINVAL}
    | {errno.EEXIST, errno.EISDIR, errno.ENOENT, errno.ELOOP}
)
_LOCK = re.compile(r"process \d+ on .* since [\d :-]+")
_LONGEST = ".replaced-01234567"


@contextmanager
def making_parents(out: Path) -> Iterator[None]:
    """The folders above ``out`` are there in the block; those that this made are gone after it, if empty.

    Raises:
        InputError: they can't be made.
    """
    missing: list[Path] = []

    def end() -> None:
        with suppress(OSError):
            for parent in missing:
                parent.rmdir()

    with stopping.ended_by(end):
        with _as_input_errors(out):
            missing += [parent for parent in out.parents if not parent.exists()]
            out.parent.mkdir(parents=True, exist_ok=True)
            # The longest name that is wanted beside it, tried before anything is computed.
            with suppress(FileNotFoundError):
                (out.parent / f".{out.name}{_LONGEST}").lstat()
        yield


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """A lock on ``out`` by a file beside it, which is gone after the block; a dead process holds none.

    Raises:
        InputError: another process holds it, or the file can't be made.
    """
    from filelock import FileLock, Timeout

    path = _hidden(out, "lock")
    if path.is_symlink() or (_said_of(path) and not _LOCK.fullmatch(_said_of(path))):
        require_left_over(path)
    # A moment's patience, since a command that is just ending removes its file.
    lock = FileLock(path, timeout=0.2)
    try:
        with _as_input_errors(out):
            lock.acquire()
    except Timeout:
        raise InputError(_in_use(out, path) if path.exists() else _no_place(out, "no such place")) from None
    try:
        # Whoever waits for a file that is gone begins again with another, so it may go while it is locked.
        with stopping.ended_by(lambda: path.unlink(missing_ok=True)):
            with _as_input_errors(out):
                now = f"{datetime.now().astimezone():%Y-%m-%d %H:%M}"
                path.write_text(f"process {os.getpid()} on {platform.node()} since {now}\n", encoding="utf-8")
            yield
    finally:
        lock.release()


def _in_use(out: Path, path: Path) -> Problem:
    words = _said_of(path) or "another command"
    return Problem.stated("out-in-use", str(out), value=f"a folder in use by {words}")


def _said_of(path: Path) -> str:
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
        raise InputError(_no_place(out, error.strerror or str(error))) from error


def _no_place(out: Path, why: str) -> Problem:
    file = _file_above(out)
    if file is not None:
        return Problem.stated("out-unwritable.above", str(out), value="a file above it", path=file)
    return Problem.stated("out-unwritable.here", str(out), value=why)


def _file_above(out: Path) -> Path | None:
    for parent in out.parents:
        with suppress(OSError):
            if parent.exists() and not parent.is_dir():
                return parent
    return None


GO_ON = "run the same command again to go on from here"


class Place:
    """A claimed place for results; see `claim`.

    Attributes:
        path: where the results go, as the user named it; beside that if the name was taken meanwhile.
    """

    def __init__(self, path: Path, out: Path, command: str, *, overwrite: bool) -> None:
        self.path = path
        self.remark = ""
        self._out, self._command, self._overwrite = out, command, overwrite

    @contextmanager
    def folder(self) -> Iterator[Path]:
        """A staging folder that takes the place when the block ends, and vanishes if it fails.

        It lies beside the place, so that the last step is a rename on one file system. Where something else
        has taken the place meanwhile, the results stay beside it, and the command ends with a remark.
        """
        staging = _sibling(self._out, "partial")
        with passing(staging):
            start_job(staging)
            try:
                yield staging
                write_mark(staging, self._command)
            except OSError as error:
                # A write that fails does not say where.
                error.filename = error.filename or str(self.path)
                raise
            staging.chmod(0o755)
            self._put(staging)

    @contextmanager
    def unfinished(self, job: str) -> Iterator[Path]:
        """A folder beside the place for the finished parts of a ``job``, gone when the block ends well.

        Where it does not, parts stay for the next run of the same job. Those of other jobs are discarded.

        Args:
            job: a fingerprint of everything that the parts depend on, by which their folder is named.

        Raises:
            InputError: a link, or something that no job left, has the name of the folder.
        """
        parts = _hidden(self._out, "unfinished")
        folder = parts / job[:32]
        require_left_over(parts)
        for entry in parts.iterdir() if parts.exists() else ():
            if entry.is_symlink() or entry not in {folder, parts / MARK}:
                remove(entry)
        with stopping.explained(lambda: _kept_words(parts)):
            try:
                if not (parts / MARK).is_file():
                    remove(parts)
                    start_job(parts)
                folder.mkdir(exist_ok=True)
                yield folder
            except BaseException as error:
                if words := _kept_words(parts):
                    error.add_note(words)
                raise
            discard(parts)

    def _put(self, staging: Path) -> None:
        try:
            require_free(self._out, overwrite=self._overwrite)
            _replace(staging, self._out)
        except (InputError, OSError) as error:
            taken = self._out
            self._out = _free_beside(taken)
            staging.rename(self._out)
            self.path = self._out
            why = error if isinstance(error, OSError) else "it was taken while this command ran"
            self.remark = f"{taken} could not be replaced ({why}); the results are in {self._out}"


def claim_if(
    out: Path | None, *, overwrite: bool, command: str, inputs: Sequence[str | Path | None]
) -> AbstractContextManager[Place | None]:
    """`claim` of a folder that a command may do without; None where there is none."""
    if out is None:
        return nullcontext()
    return claim(out, overwrite=overwrite, command=command, inputs=inputs)


@contextmanager
def claim(
    out: Path, *, overwrite: bool = False, command: str, inputs: Sequence[str | Path | None] = ()
) -> Iterator[Place]:
    """The place ``out`` for one command's results, refused to all others until the block ends.

    Results that an earlier command was replacing when it was killed are put back first.

    Args:
        out: a folder that is new or empty; with ``overwrite``, also one that this program wrote.
        overwrite: replace what ``out`` holds, if all of that is this program's own.
        command: what writes the results.
        inputs: files and folders that the command reads; nothing that holds one is replaced.

    Raises:
        InputError: ``out`` would lose something, can't be made, or another command is writing it.
        PartialResultError: the results could not take their place, and are beside it.
    """
    with locked_folder(out, inputs) as target:
        _recover(target)
        require_free(target, overwrite=overwrite)
        claimed = Place(Path(out), target, command, overwrite=overwrite)
        yield claimed
    if claimed.remark:
        raise PartialResultError(claimed.remark, code="results-elsewhere")


def _replace(staging: Path, out: Path) -> None:
    """Give ``staging`` the name ``out``; the results that had it step aside first, and back if that fails."""
    with stopping.whole_step():
        retired = _sibling(out, "replaced") if out.exists() else None
        if retired is not None:
            out.rename(retired)
        try:
            staging.rename(out)
        except BaseException:
            if retired is not None:
                retired.rename(out)
            raise
        if retired is None:
            return
        # No longer the only copy of anything, and so no longer put back by a later run.
        remains = _sibling(out, "partial")
        with suppress(OSError):
            retired.rename(remains)
    with suppress(OSError):
        discard(remains)


def _recover(out: Path) -> None:
    """Clear away what a killed command left beside ``out``, and put back what it was about to replace."""
    for path in _siblings(out, "partial"):
        discard(path)
    replaced = sorted(_siblings(out, "replaced"), key=lambda path: path.stat().st_mtime)
    if replaced and not out.exists():
        replaced.pop().rename(out)
        _tell(f"{out}: a command was ended while it replaced these results; they are back in their place")
    for path in replaced:
        _tell(f"{path}: earlier results of {out.name}, kept; delete them if you do not want them")


def _tell(words: str) -> None:
    print(printable(words, lines=True), file=sys.stderr)  # noqa: T201


def _kept_words(folder: Path) -> str:
    """What to say of the finished parts in ``folder``; without any it is removed."""
    parts = False
    for parent, _, names in os.walk(folder):
        for name in names:
            if name == MARK:
                continue
            if ".partial-" in name:
                (Path(parent) / name).unlink(missing_ok=True)
            else:
                parts = True
    if not parts:
        remove(folder)
    return GO_ON if parts else ""


@contextmanager
def locked_folder(out: Path, inputs: Sequence[str | Path | None]) -> Iterator[Path]:
    """Where ``out`` leads, which one process at a time writes: refused to all others until the block ends.

    Raises:
        InputError: it can't be made, or another command is writing it.
    """
    target = require_place(out, inputs)
    with making_parents(target), locked(target):
        yield target


@contextmanager
def locked_in_place(folder: Path) -> Iterator[None]:
    """A folder that is there and that one process at a time writes files into, wherever it lies.

    Raises:
        InputError: nothing can be written beside it, or another command is writing it.
    """
    with locked(folder.resolve()):
        yield


def _hidden(out: Path, kind: str) -> Path:
    return out.parent / f".{out.name}.{kind}"


def _sibling(out: Path, kind: str) -> Path:
    return _hidden(out, f"{kind}-{secrets.token_hex(4)}")


def _siblings(out: Path, kind: str) -> list[Path]:
    pattern = re.compile(rf"\.{re.escape(out.name)}\.{kind}-[0-9a-f]{{8}}")
    return [path for path in out.parent.iterdir() if pattern.fullmatch(path.name) and is_left_over(path)]


def _free_beside(out: Path) -> Path:
    number = 2
    while (free := out.with_name(f"{out.name}-{number}")).exists():
        number += 1
    return free
