"""Tables of result folders: made, written, read and checked by the one declaration of their columns.

``tables.toml`` declares every file; the manual's page of result files is made of it too.
"""

from __future__ import annotations

import locale
import re
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from bayestissue.declarations import declared
from bayestissue.errors import InputError, Problem, all_of, refuse

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.remedies import Code

AGAIN = (
    "Give the folder of a finished run, or make it anew with `bayestissue fit` or `bayestissue reproduce`."
)
# The decimal mark of the spreadsheet; "auto" stands for that of the machine's language and country.
Excel = Literal["auto", "comma", "point"]
HELD = "a file that a finished run holds"
_MARK = "\ufeff"
# What a spreadsheet takes for the begin of a formula, but for numbers.
_COMPUTED = ("=", "+", "-", "@", "\t", "\r")
_NUMBER = r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(inf|nan)"
_WITH_COMMA = r"([+-]?\d+(,\d+)?([eE][+-]?\d+)?|nan|[+-]?inf)?"


class Column(NamedTuple):
    """A column of a table: its meaning, the kind of its cells, and whether a table may lack it."""

    meaning: str
    kind: Literal["text", "number", "whole"]
    may_lack: bool


class File(NamedTuple):
    """A file of a result folder: the commands that write it, what it (or a row) is, and its columns."""

    by: tuple[str, ...]
    holds: str
    columns: dict[str, Column]


@cache
def declared_files() -> dict[str, File]:
    """Every file of a result folder by its name."""
    content = declared(__package__, "tables.toml")
    return {name: _file(name, content) for name in content["files"]}


def _file(name: str, content: dict[str, Any]) -> File:
    entry = content["files"][name]
    means = entry.get("means", {})
    meanings = content["means"] | (content["files"][means]["means"] if isinstance(means, str) else means)
    text, whole, may_lack = (entry.get(key, "").split() for key in ("text", "whole", "may_lack"))
    columns = {
        column: Column(
            meanings[column],
            "text" if column in text else "whole" if column in whole else "number",
            column in may_lack,
        )
        for column in entry.get("columns", "").split()
    }
    return File(tuple(entry["by"]), entry["holds"], columns)


def columns_of(name: str) -> list[str]:
    """The columns of a table, in order; ``name`` is that of its file without suffix."""
    return list(declared_files()[f"{name}.csv"].columns)


def table_of_rows(name: str, rows: Iterable[Any] = ()) -> pd.DataFrame:
    """A table with the columns declared for ``name``; rows are tuples in their order, or mappings."""
    import pandas as pd

    return pd.DataFrame(list(rows), columns=columns_of(name))


def joined(name: str, parts: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Parts of the table ``name`` one below the other, its columns in order; empty where there are none."""
    import pandas as pd

    columns = columns_of(name)
    return pd.concat(parts, ignore_index=True)[columns] if parts else pd.DataFrame(columns=columns)


def wrong_in(
    path: Path | str, expected: str, remedy: str = AGAIN, *, code: Code = "damaged-run", **location: Any
) -> Problem:
    """What is wrong with a file of a run; ``location`` says where in it, and what stands there."""
    return Problem(str(path), expected, remedy, code=code, **location)


def typed(name: str, table: pd.DataFrame, path: Path | str = "") -> pd.DataFrame:
    """A table with text and numbers where they are declared; a column that isn't has numbers if it can.

    Raises:
        InputError: every column that lacks, and every cell of a number that holds something else, of the
            table at ``path``.
    """
    import pandas as pd

    declared = declared_files()[f"{name}.csv"].columns
    problems = [
        wrong_in(path, "this column", row=1, column=column)
        for column, kind in declared.items()
        if not kind.may_lack and column not in table
    ]
    columns: dict[str, pd.Series] = {}
    for column in map(str, table.columns):
        cells = table[column]
        if column in declared and declared[column].kind == "text":
            columns[column] = cells.where(cells.notna(), "").astype(str)
            continue
        numbers = pd.to_numeric(cells, errors="coerce") if len(cells) else cells.astype(float)
        unread = cells[numbers.isna() & cells.notna()]
        wrong = unread[~unread.astype(str).str.lower().isin(["", "nan"])]
        columns[column] = cells if len(wrong) else numbers
        if column in declared:
            problems += [
                wrong_in(path, "a number or nothing", row=int(index) + 2, column=column, value=cell)
                for index, cell in zip(wrong.index, wrong, strict=True)
            ]
    refuse(problems)
    return pd.DataFrame(columns, index=table.index)


def write_table(table: pd.DataFrame, path: Path, excel: Excel | None = None) -> None:
    """Write a CSV file.

    Args:
        table: without its index.
        path: of the file.
        excel: None for programs: UTF-8, commas, decimal points. Else as a spreadsheet with this decimal mark
            opens it by itself: UTF-8 with a mark, and between cells semicolons beside decimal commas.
    """
    if excel is None:
        table.to_csv(path, index=False)
        return
    decimal = {"comma": ",", "point": "."}.get(excel) or _decimal_here()
    separator = ";" if decimal == "," else ","
    texts = table.select_dtypes(exclude="number")
    table = table.assign(**{str(name): texts[name].map(as_text) for name in texts}).rename(columns=as_text)
    table.to_csv(
        path, index=False, encoding="utf-8-sig", sep=separator, decimal=decimal, lineterminator="\r\n"
    )


def as_text(cell: Any) -> Any:
    """A cell that a spreadsheet takes as it stands, whatever a name begins with.

    A spreadsheet computes what begins with =, +, - or @, and shows what begins with an apostrophe as text.
    Numbers stay; `_as_written` is the way back.
    """
    return f"'{cell}" if isinstance(cell, str) and _computed(cell) else cell


def _as_written(cell: str) -> str:
    """The text of a cell before `as_text`."""
    return cell[1:] if cell.startswith("'") and _computed(cell) else cell


def _computed(cell: str) -> bool:
    bare = cell.lstrip("'")
    return bare.startswith(_COMPUTED) and not re.fullmatch(_NUMBER, bare)


def read_table(folder: Path, name: str) -> pd.DataFrame:
    """The table ``name`` of a folder, whoever it was written for, with text and numbers as of `typed`.

    Raises:
        InputError: the file lacks or can't be read, a column lacks, or a cell holds no number.
    """
    import pandas as pd

    path = folder / f"{name}.csv"
    if not path.is_file():
        raise InputError(wrong_in(path, HELD, value="no such file"))
    declared = declared_files()[f"{name}.csv"].columns
    try:
        with path.open(encoding="utf-8") as file:
            first = file.readline()
        # No name of a column has a semicolon.
        commas = first.startswith(_MARK) and ";" in first
        separator = ";" if commas else ","
        table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8-sig", sep=separator)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(wrong_in(path, "a table as a run writes it", value=type(error).__name__)) from error
    if first.startswith(_MARK):
        table = table.rename(columns=_as_written).map(_as_written)
    if commas:
        for column in table:
            is_text = column in declared and declared[column].kind == "text"
            if not is_text and table[column].str.fullmatch(_WITH_COMMA).all():
                table[column] = table[column].str.replace(",", ".", regex=False)
    return typed(name, table, path)


def read_tables(folder: Path, names: Sequence[str], may_lack: Sequence[str] = ()) -> dict[str, pd.DataFrame]:
    """Several tables by name, those of ``may_lack`` only where they are.

    Raises:
        InputError: all the files that can't be read and all that is wrong in others, at once.
    """
    present = [*names, *(name for name in may_lack if (folder / f"{name}.csv").is_file())]
    return dict(zip(present, all_of(lambda name: read_table(folder, name), present), strict=True))


def _decimal_here() -> str:
    """The decimal mark of the machine's language and country."""
    before = locale.setlocale(locale.LC_NUMERIC)
    try:
        locale.setlocale(locale.LC_NUMERIC, "")
        return str(locale.localeconv()["decimal_point"])
    except locale.Error:
        return "."
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
