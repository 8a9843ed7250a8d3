"""The manifest of every folder that this program writes: what it wrote there, and so what it may replace.

``.bayestissue.json`` names the command, and of every file its SHA-256.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from bayestissue.base.errors import InputError, refuse
from bayestissue.base.outline import first_of
from bayestissue.base.results.files import file_sha256, remove
from bayestissue.base.results.tables import wrong_in

MANIFEST = ".bayestissue.json"
# Pages are drawn, and drawn anew, after the manifest was written.
_PAGES = frozenset({"report.html", "check.html"})
_DATASET = "dataset.toml"
# What file managers leave in any folder, and a page that a killed process had not finished.
_LITTER = re.compile(r"\.DS_Store|Thumbs\.db|desktop\.ini|\..+\.partial-\w+(\.html)?")


def write_manifest(folder: Path, command: str) -> None:
    """Mark a folder as written by a command, with all that is in it now."""
    paths = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*"))}
    pages = _PAGES | {MANIFEST}
    hashes = {name: file_sha256(path) for name, path in paths.items() if path.is_file() and name not in pages}
    content = {"program": "bayestissue", "command": command, "sha256": hashes}
    (folder / MANIFEST).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def mark_unfinished(folder: Path) -> None:
    """Mark a folder as what a job has not finished, so that a later one may remove it."""
    content = json.dumps({"program": "bayestissue", "unfinished": True})
    (folder / MANIFEST).write_text(content, encoding="utf-8")


def require_left_over(path: Path) -> None:
    """Refuse a hidden name that a job needs where something has it that no job left.

    A job that was killed leaves a folder that is marked as unfinished, one that is empty, or results and
    nothing else.

    Raises:
        InputError: a link, or a person's own.
    """
    if path.is_symlink():
        raise InputError.stated("out-taken.hidden", str(path), value="a link")
    try:
        own = not path.exists() or not any(path.iterdir()) or "unfinished" in _read(path) or not foreign(path)
    except OSError:
        own = False
    if not own:
        value = "something that no command of bayestissue left"
        raise InputError.stated("out-taken.hidden", str(path), value=value)


def discard(folder: Path) -> None:
    """Remove a folder that is marked as unfinished; its mark goes last, if this is killed too."""
    for entry in folder.iterdir() if folder.exists() else ():
        if entry.name != MANIFEST:
            remove(entry)
    remove(folder)


def foreign(folder: Path) -> list[str]:
    """What in a folder is not this program's own, as names; empty if all of it may be replaced.

    A dataset is meant to be changed, and one that was changed is a person's.
    """
    written, is_dataset = _hashes(folder), (folder / _DATASET).exists()
    if written is None:
        return ["a dataset" if is_dataset else "nothing that says that bayestissue wrote it"]
    known = written.keys() | _PAGES | {MANIFEST}
    parents = {str(parent) for name in known for parent in Path(name).parents}
    others = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            others.append(f"{name} (a link)")
        elif path.is_dir():
            others += [] if name in parents else [f"{name}/"]
        elif name not in known and not _LITTER.fullmatch(path.name):
            others.append(name)
    lacks = not all((folder / name).is_file() for name in written)
    if is_dataset and not others and (lacks or _changed(folder)):
        return ["a dataset that was changed since it was written"]
    return others


def require_as_written(folder: Path) -> None:
    """Refuse results of which a file was changed since it was written.

    Raises:
        InputError: every file with other bytes.
    """
    expected, value = "the bytes that were written", "others: it was edited, or damaged"
    refuse(wrong_in(folder / name, expected, value=value) for name in _changed(folder))


def _changed(folder: Path) -> list[str]:
    """The files that have other bytes than were written, by name."""
    written = (_hashes(folder) or {}).items()
    files = [(name, sha256) for name, sha256 in written if (folder / name).is_file()]
    return [name for name, sha256 in files if file_sha256(folder / name) != sha256]


def _hashes(folder: Path) -> dict[str, str] | None:
    """The files that this program wrote there, None if it wrote none."""
    hashes = _read(folder).get("sha256")
    return hashes if isinstance(hashes, dict) else None


def _read(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
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
    suffixes: Sequence[str],
    is_own: Callable[[Path], bool],
    *,
    overwrite: bool,
    inputs: Sequence[str | Path | None],
) -> None:
    """Refuse a file of `predict --draws` that would cost something or can't be written.

    Args:
        path: of the file.
        suffixes: how its name may end.
        is_own: whether a file is one that the program wrote, which alone is replaced.
        overwrite: replace it then.
        inputs: what the command reads.

    Raises:
        InputError: what is wrong.
    """
    option = "--draws"
    where = f"{option} {str(path)!r}"
    if path.suffix not in suffixes:
        kinds = " or ".join(suffixes)
        raise InputError.stated("file-taken.suffix", where, value=path.suffix, kinds=kinds)
    resolved = require_place(path, inputs, option)
    if resolved.exists() and not overwrite:
        raise InputError.stated("file-taken.own", where, value="a name that is taken")
    if resolved.exists() and not (resolved.is_file() and is_own(resolved)):
        raise InputError.stated("file-taken.others", where, value="no such file of bayestissue")
    try:
        with TemporaryFile(dir=next(parent for parent in resolved.parents if parent.exists())):
            pass
    except OSError as error:
        raise InputError.stated("file-taken.place", where, value=error.strerror) from error


def _wrong_place(out: Path, inputs: Sequence[str | Path | None]) -> tuple[str, str, str | Path] | None:
    """What is wrong with a place: the message, what it is, and the folder or file that is in the way."""
    protected = {"the working folder": Path.cwd()}
    with suppress(RuntimeError):
        protected["the home folder"] = Path.home().resolve()
    for name, folder in protected.items():
        if folder.is_relative_to(out):
            which = name if out == folder else f"a folder that holds {name}"
            return "out-taken.folder", which, folder
    if out.is_mount():
        return "out-taken.folder", "a mount point, which can't be replaced", out
    for path in inputs:
        # Text may be the name of a model of the program: `--model impact --out impact` is no conflict.
        is_name = isinstance(path, str) and not Path(path).is_file()
        if path is not None and not is_name and Path(path).resolve().is_relative_to(out):
            return "out-taken.input", "what this command reads or writes", path
    for parent in out.parents:
        if _hashes(parent) is not None and not (parent / _DATASET).exists():
            return "out-taken.inside", "a folder inside other results", parent
    return None
