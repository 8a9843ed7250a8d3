"""The mark in every folder that this program writes: what it wrote there, and so what it may replace.

A result folder holds ``.bayestissue.json``: the command, and of every file its name, size and SHA-256. Of a
dataset, as `simulate` and `Dataset.write` make it, it has one hash of the contents, since people change it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from bayestissue import runtime
from bayestissue.errors import InputError
from bayestissue.outline import first_of
from bayestissue.results.files import file_sha256, remove

MARK = ".bayestissue.json"
# Pages are drawn, and drawn anew, after the mark was written.
_PAGES = frozenset({"report.html", "check.html"})
_DATASET = "dataset.toml"
# What file managers leave in any folder, and a page that a killed process had not finished.
_LITTER = re.compile(r"\.DS_Store|Thumbs\.db|desktop\.ini|\..+\.partial-\w+(\.html)?")


def write_mark(folder: Path, command: str) -> None:
    """Mark a folder as written by a command, with all that is in it now."""
    files = {name: (folder / name).stat().st_size for name in _files(folder)}
    content: dict[str, Any] = {"program": "bayestissue", "command": command, "files": files}
    if _DATASET in files:
        content["content_hash"] = _content_hash(folder, files)
    else:
        content["sha256"] = {name: file_sha256(folder / name) for name in files if name not in _PAGES}
    (folder / MARK).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def start_job(folder: Path) -> None:
    """Make a folder for what a job has not finished, marked so that a later one may remove it."""
    folder.mkdir(mode=0o700)
    (folder / MARK).write_text(json.dumps({"program": "bayestissue", "unfinished": True}), encoding="utf-8")


def is_left_over(folder: Path) -> bool:
    """Whether a folder is what a job left when it was killed: no link, and nothing that a person made.

    That is one that `start_job` made, one that is empty, or results and nothing else.
    """
    if folder.is_symlink() or not folder.is_dir():
        return False
    try:
        return not any(folder.iterdir()) or "unfinished" in _read(folder / MARK) or not foreign(folder)
    except OSError:
        return False


def require_left_over(path: Path) -> None:
    """Refuse a hidden name that a job needs where something has it that no job left.

    Raises:
        InputError: a link, or a person's own.
    """
    if path.is_symlink() or (path.exists() and not is_left_over(path)):
        kind = "a link" if path.is_symlink() else "something that no command of bayestissue left"
        raise InputError.stated("out-taken.hidden", str(path), value=kind)


def discard(folder: Path) -> None:
    """Remove a folder of a job; its mark goes last, for whoever goes on where this was killed."""
    for entry in folder.iterdir():
        if entry.name != MARK:
            remove(entry)
    remove(folder)


def is_result(folder: Path) -> bool:
    """Whether this program wrote the folder, as results and not as a dataset."""
    return _written(folder) is not None and not (folder / _DATASET).exists()


def foreign(folder: Path) -> list[str]:
    """What in a folder is not this program's own, as names; empty if all of it may be replaced."""
    written = _written(folder)
    if written is None:
        dataset = (folder / _DATASET).exists()
        return ["a dataset" if dataset else "nothing that says that bayestissue wrote it"]
    others = [name for name in _entries(folder, written) if name not in written]
    mark = _read(folder / MARK)
    if (folder / _DATASET).exists() and not others:
        files = [name for name in mark["files"] if (folder / name).is_file()]
        if len(files) < len(mark["files"]) or mark.get("content_hash") != _content_hash(folder, files):
            return ["a dataset that was changed since it was written"]
    return others


def damaged(folder: Path) -> dict[str, tuple[str, str]]:
    """Files that are not as they were written: what was written, and what is there now, in words.

    A file of the same size is known by its hash, which is computed once in a process.
    """
    mark = _read(folder / MARK)
    sizes, hashes = (mark.get(key, {}) for key in ("files", "sha256"))
    changes: dict[str, tuple[str, str]] = {}
    for name in (name for name in _files(folder) if name in sizes and name not in _PAGES):
        status = (folder / name).stat()
        if status.st_size != sizes[name]:
            changes[name] = f"{sizes[name]} bytes, as they were written", f"{status.st_size} bytes"
        elif name in hashes and _known(folder / name, status.st_mtime_ns, status.st_size) != hashes[name]:
            changes[name] = "the bytes that were written", "as many others: it was edited, or damaged"
    return changes


@cache
def _known(path: Path, changed_ns: int, size: int) -> str:
    return file_sha256(path)


def _written(folder: Path) -> frozenset[str] | None:
    """The files that this program wrote there, None if it wrote none."""
    mark = _read(folder / MARK)
    if mark.get("program") == "bayestissue" and isinstance(mark.get("files"), dict):
        return frozenset(mark["files"]) | _PAGES | {MARK}
    return None


def _entries(folder: Path, written: frozenset[str]) -> Iterator[str]:
    """Everything in the folder that is no litter; of folders in it those alone that hold nothing of ours."""
    parents = {str(parent) for name in written for parent in Path(name).parents}
    for path in sorted(folder.iterdir()):
        name = path.name
        if path.is_symlink():
            yield f"{name} (a link)"
        elif not path.is_dir():
            if not _LITTER.fullmatch(name):
                yield name
        elif name in parents:
            start = f"{name}/"
            inner = frozenset(file.removeprefix(start) for file in written if file.startswith(start))
            yield from (f"{start}{entry}" for entry in _entries(path, inner))
        else:
            yield f"{name}/"


def _files(folder: Path) -> list[str]:
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != MARK)
    return [path.relative_to(folder).as_posix() for path in paths]


def _content_hash(folder: Path, files: Any) -> str:
    return runtime.content_hash([folder / name for name in files])


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def require_place(out: Path, inputs: Sequence[str | Path | None] = (), option: str = "--out") -> Path:
    """Where ``out`` leads, refused if results must never stand there, with ``--overwrite`` or without.

    That is the working folder, the home folder, a root, a mount point, what holds one of these or an input,
    and the inside of other results. An empty path is the working folder. ``option`` is what gives it.

    Raises:
        InputError: what ``out`` is, and what to do.
    """
    try:
        resolved = Path(out).resolve()
        wrong = _wrong_place(resolved, inputs)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError.stated("out-unwritable.here", str(out), value=str(error)) from error
    if wrong is not None:
        key, value, path = wrong
        raise InputError.stated(key, f"{option} {str(out)!r}", value=value, path=path, option=option)
    return resolved


def require_free(out: Path, *, overwrite: bool) -> None:
    """Refuse an ``out`` that would lose something.

    Raises:
        InputError: ``out`` is a file, or a folder that is not empty; with ``overwrite``, a folder that holds
            anything that this program did not write.
    """
    if out.exists() and not out.is_dir():
        raise InputError.stated("out-taken.file", str(out), value="a file")
    if not out.is_dir() or not any(out.iterdir()):
        return
    others = foreign(out)
    if not overwrite:
        key = "out-taken.others" if others else "out-taken.results"
        raise InputError.stated(key, str(out), value="a folder that is not empty")
    if others:
        raise InputError.stated("out-taken.mixed", str(out), value=first_of(others, most=3))


def require_file(
    path: Path,
    option: str,
    *,
    suffixes: Sequence[str],
    is_own: Callable[[Path], bool],
    overwrite: bool,
    inputs: Sequence[str | Path | None],
) -> None:
    """Refuse a single file of results that would cost something, can't be written, or whose kind is none.

    Args:
        path: of the file.
        option: what gives it.
        suffixes: how its name may end.
        is_own: whether a file that is there is such results, which alone are replaced.
        overwrite: replace it then.
        inputs: what the command reads.

    Raises:
        InputError: what is wrong.
    """
    where, kinds = f"{option} {str(path)!r}", " or ".join(suffixes)
    if path.suffix not in suffixes:
        raise InputError.stated("file-taken.suffix", where, value=path.suffix, kinds=kinds)
    resolved = require_place(path, inputs, option)
    if resolved.exists() and not (overwrite and resolved.is_file() and is_own(resolved)):
        key, value = (
            ("others", "no such file of bayestissue") if overwrite else ("own", "a name that is taken")
        )
        raise InputError.stated(f"file-taken.{key}", where, value=value)
    try:
        with TemporaryFile(dir=next(parent for parent in resolved.parents if parent.exists())):
            pass
    except OSError as error:
        raise InputError.stated("file-taken.place", where, value=error.strerror) from error


def _wrong_place(out: Path, inputs: Sequence[str | Path | None]) -> tuple[str, str, str | Path] | None:
    """What is wrong with a place: the message, what it is, and the folder or file that is in the way."""
    for folder, name in ((Path.cwd(), "the working folder"), (_home(), "the home folder")):
        if folder is not None and _holds(out, folder):
            which = name if out == folder else f"a folder that holds {name}"
            return "out-taken.folder", which, folder
    if out.is_mount():
        return "out-taken.folder", "a mount point, which can't be replaced", out
    for path in inputs:
        # Text may be the name of a model of the program: `--model impact --out impact` is no conflict.
        is_name = isinstance(path, str) and not Path(path).is_file()
        if path is not None and not is_name and _holds(out, Path(path).resolve()):
            return "out-taken.input", "what this command reads or writes", path
    for parent in out.parents:
        if is_result(parent):
            return "out-taken.inside", "a folder inside other results", parent
    return None


def _holds(folder: Path, path: Path) -> bool:
    return path == folder or folder in path.parents


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except RuntimeError:
        return None
