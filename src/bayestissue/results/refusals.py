"""Which folders may take results: none whose loss would be more than that of earlier results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayestissue.errors import InputError, Problem
from bayestissue.outline import first_of
from bayestissue.results.mark import foreign, is_result

_BELOW = "Choose another --out, such as a new folder in it."
_ANOTHER = "Choose another --out."
_NAMED = 3


def require_place(out: Path, inputs: Sequence[str | Path | None] = ()) -> Path:
    """Where ``out`` leads, refused if results must never stand there, with ``--overwrite`` or without.

    That is the working folder, the home folder, a root, a mount point, what holds one of these or an input,
    and the inside of other results. An empty path is the working folder.

    Raises:
        InputError: what ``out`` is, and what to do.
    """
    try:
        resolved = Path(out).resolve()
        wrong = _wrong_place(resolved, inputs)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(
            Problem(
                str(out),
                "a folder that can be made and written",
                _ANOTHER,
                value=str(error),
                code="out-unwritable",
            )
        ) from error
    if wrong is not None:
        value, expected, remedy = wrong
        raise InputError(
            Problem(f"--out {str(out)!r}", expected=expected, remedy=remedy, value=value, code="out-taken")
        )
    return resolved


def require_free(out: Path, *, overwrite: bool) -> None:
    """Refuse an ``out`` that would lose something.

    Raises:
        InputError: ``out`` is a file, or a folder that is not empty; with ``overwrite``, a folder that holds
            anything that this program did not write.
    """
    if out.exists() and not out.is_dir():
        raise InputError(
            Problem(
                str(out),
                expected="a folder or a name not yet taken",
                remedy=_ANOTHER,
                value="a file",
                code="out-taken",
            )
        )
    if not out.is_dir() or not any(out.iterdir()):
        return
    others = foreign(out)
    if not overwrite:
        remedy = (
            f"{_ANOTHER}" if others else "Choose another --out, or pass --overwrite to replace these results."
        )
        raise InputError(
            Problem(
                str(out),
                expected="an empty folder or a name not yet taken",
                remedy=remedy,
                value="a folder that is not empty",
                code="out-taken",
            )
        )
    if others:
        raise InputError(
            Problem(
                str(out),
                expected="a folder that holds results of bayestissue and nothing else, which alone "
                "--overwrite replaces",
                remedy="Choose another --out, or move what is in it elsewhere.",
                value=first_of(others, _NAMED),
                code="out-taken",
            )
        )


def _wrong_place(out: Path, inputs: Sequence[str | Path | None]) -> tuple[str, str, str] | None:
    for folder, name in ((Path.cwd(), "the working folder"), (_home(), "the home folder")):
        if folder is not None and _holds(out, folder):
            which = name if out == folder else f"a folder that holds {name}"
            return which, "a folder of its own for the results", _BELOW
    if out.is_mount():
        return "a mount point, which can't be replaced", "a folder of its own for the results", _BELOW
    for path in inputs:
        # Text may be the name of a model of the program: `--model impact --out impact` is no conflict.
        is_name = isinstance(path, str) and not Path(path).is_file()
        if path is not None and not is_name and _holds(out, Path(path).resolve()):
            return "what this command reads", f"a folder that does not hold {path}", _ANOTHER
    for parent in out.parents:
        if is_result(parent):
            return "a folder inside other results", f"a folder outside {parent}", _ANOTHER
    return None


def _holds(folder: Path, path: Path) -> bool:
    return path == folder or folder in path.parents


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except RuntimeError:
        return None
