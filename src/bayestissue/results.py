"""Result folders that appear under their final name only when they are whole."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bayestissue.errors import InputError, Problem

_unfinished: set[Path] = set()


def require_free(out: Path, *, overwrite: bool) -> None:
    """Refuse an ``--out`` that would lose something.

    Raises:
        InputError: ``out`` is a file, or a folder that is not empty and ``overwrite`` is false.
    """
    if out.exists() and not out.is_dir():
        raise InputError(
            Problem(
                str(out),
                expected="a folder or a name not yet taken",
                remedy="Choose another --out.",
                value="a file",
            )
        )
    if not overwrite and out.is_dir() and any(out.iterdir()):
        raise InputError(
            Problem(
                str(out),
                expected="an empty folder or a name not yet taken",
                remedy="Choose another --out, or pass --overwrite to replace what is there.",
                value="a folder that is not empty",
            )
        )


@contextmanager
def whole_folder(out: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A staging folder that takes the name ``out`` when the block ends, and vanishes if it fails.

    The staging folder lies beside ``out``, so that the final step is a rename on one file system:
    a process killed at any moment leaves the old ``out`` or the new one, never a mixture.

    Raises:
        InputError: see `require_free`.
    """
    out = Path(out).absolute()
    require_free(out, overwrite=overwrite)
    out.parent.mkdir(parents=True, exist_ok=True)
    staging = out.parent / f".{out.name}.partial-{secrets.token_hex(4)}"
    # Known before it is there, so that no moment of interruption leaves it behind.
    _unfinished.add(staging)
    try:
        staging.mkdir(mode=0o700)
        yield staging
        staging.chmod(0o755)
        _replace(staging, out)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        _unfinished.discard(staging)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path that takes the name ``path`` when the block ends without an error."""
    path = Path(path).absolute()
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.partial-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    staging = Path(name)
    _unfinished.add(staging)
    try:
        yield staging
        staging.chmod(0o644)
        staging.replace(path)
    finally:
        staging.unlink(missing_ok=True)
        _unfinished.discard(staging)


def discard_unfinished() -> None:
    """Clear away what no block will finish, for a process that must leave at once."""
    for staging in tuple(_unfinished):
        if staging.is_dir():
            shutil.rmtree(staging, ignore_errors=True)
        else:
            staging.unlink(missing_ok=True)


def unfinished(out: Path, job: str) -> Path:
    """The folder beside ``out`` where the finished parts of this ``job`` wait, emptied if they are another's.

    Args:
        out: where the results will go.
        job: a fingerprint of everything that the parts depend on.
    """
    out = out.absolute()
    folder = out.parent / f".{out.name}.unfinished"
    mark = folder / "job"
    if folder.is_dir() and not (mark.is_file() and mark.read_text(encoding="utf-8") == job):
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(mark) as staging:
        staging.write_text(job, encoding="utf-8")
    return folder


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write an indented JSON file as people read it."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def _replace(staging: Path, out: Path) -> None:
    if not out.exists():
        staging.rename(out)
        return
    # A folder can't be renamed onto one that is not empty: the old one steps aside first.
    retired = Path(tempfile.mkdtemp(prefix=f".{out.name}.partial-old-", dir=out.parent))
    out.rename(retired / out.name)
    try:
        staging.rename(out)
    except OSError:
        (retired / out.name).rename(out)
        raise
    finally:
        shutil.rmtree(retired, ignore_errors=True)
