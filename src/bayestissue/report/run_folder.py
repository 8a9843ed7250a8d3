"""The files of a finished run, read and checked before a report is made of them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.errors import InputError, Problem
from bayestissue.results import damaged

_AGAIN = (
    "Give the folder of a finished run, or make it anew with `bayestissue fit` or `bayestissue reproduce`."
)


@dataclass(frozen=True)
class TableFile:
    """A table that a run must hold: its columns of text and of numbers, and numbers that it may hold."""

    name: str
    text: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    further: tuple[str, ...] = ()


def read_about(folder: Path) -> dict[str, Any]:
    """The content of ``run.json``, which every finished run holds.

    Raises:
        InputError: the folder or the file is missing, it isn't the JSON object that a run writes, or a file
            of the run has another size than it was written with.
    """
    path = folder / "run.json"
    if not path.is_file():
        raise InputError(
            Problem(
                str(path),
                expected="a file that every finished run holds",
                remedy=_AGAIN,
                value="no such file",
                code="not-a-run",
            )
        )
    if problems := [
        Problem(
            str(folder / name),
            expected=f"{size} bytes, as they were written",
            remedy=_AGAIN,
            value=f"{found} bytes",
            code="damaged-run",
        )
        for name, (size, found) in damaged(folder).items()
    ]:
        raise InputError(problems)
    about = read_json(path)
    if not isinstance(about.get("kind"), str):
        raise InputError(
            Problem(
                str(path),
                expected='the key "kind"',
                remedy=_AGAIN,
                value=", ".join(about) or "no keys",
                code="not-a-run",
            )
        )
    return about


def require_files(folder: Path, names: list[str]) -> None:
    """Raise an `InputError` that names every one of ``names`` that ``folder`` lacks."""
    problems = [
        Problem(
            str(folder / name),
            expected="a file that a finished run holds",
            remedy=_AGAIN,
            value="no such file",
            code="damaged-run",
        )
        for name in names
        if not (folder / name).is_file()
    ]
    if problems:
        raise InputError(problems)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object.

    Raises:
        InputError: the file isn't JSON, or isn't an object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(
            Problem(
                str(path),
                expected="JSON as a run writes it",
                remedy=_AGAIN,
                value=str(error),
                code="damaged-run",
            )
        ) from error
    if not isinstance(content, dict):
        raise InputError(
            Problem(
                str(path),
                expected="a JSON object",
                remedy=_AGAIN,
                value=type(content).__name__,
                code="damaged-run",
            )
        )
    return content


def read_tables(folder: Path, layouts: tuple[TableFile, ...]) -> Mapping[str, pd.DataFrame]:
    """Every table of ``layouts`` by its name without suffix; text keeps its printed digits.

    Raises:
        InputError: all the files that can't be read and all the columns that lack, at once.
    """
    problems: list[Problem] = []
    tables = {layout.name: _read_table(folder / f"{layout.name}.csv", layout, problems) for layout in layouts}
    if problems:
        raise InputError(problems)
    return tables


def _read_table(path: Path, layout: TableFile, problems: list[Problem]) -> pd.DataFrame:
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8")
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        problems.append(
            Problem(
                str(path),
                expected="a table as a run writes it",
                remedy=_AGAIN,
                value=type(error).__name__,
                code="damaged-run",
            )
        )
        return pd.DataFrame()
    missing = [column for column in (*layout.text, *layout.numbers) if column not in table]
    problems += [
        Problem(str(path), row=1, column=column, expected="this column", remedy=_AGAIN, code="damaged-run")
        for column in missing
    ]
    for column in (*layout.numbers, *layout.further):
        if column in table:
            values = pd.to_numeric(table[column], errors="coerce")
            problems += [
                Problem(
                    str(path),
                    row=int(index) + 2,
                    column=column,
                    value=table.loc[index, column],
                    expected="a number or nothing",
                    remedy=_AGAIN,
                    code="damaged-run",
                )
                for index in table.index[values.isna() & ~table[column].str.lower().isin(["", "nan"])]
            ]
            table[column] = values.astype("float64")
    return table
