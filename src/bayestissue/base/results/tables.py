"""Tables of result folders: made, written, read and checked by the one declaration of their columns.

``tables.toml`` declares every file; the manual's page of result files is made of it too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from bayestissue.base.declarations import declared
from bayestissue.base.errors import InputError, Problem, all_of, refuse
from bayestissue.base.outcome_table import DECLARED, HEADFORM_COLUMNS, INTERVAL_MEANINGS

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.base.remedies import Code

AGAIN = (
    "Give the folder of a finished run, or make it anew with `bayestissue fit` or `bayestissue reproduce`."
)
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(inf|nan)")
HELD = "a file that a finished run holds"
# Columns that ``tables.toml`` has by the name of their group.
_GROUPS = {
    "outcomes": " ".join(HEADFORM_COLUMNS.values()),
    "intervals of outcomes": " ".join(INTERVAL_MEANINGS),
}
_OF_OUTCOMES = {one.column: one.meaning for one in DECLARED.values()}


class DeclaredColumn(NamedTuple):
    """A column of a table: its meaning, the kind of its cells, and whether a table may lack it."""

    meaning: str
    kind: Literal["text", "number", "whole"]
    may_lack: bool


class ResultFile(NamedTuple):
    """A file of a result folder: the commands that write it, what it (or a row) is, columns, and looks.

    How a table looks stands by the name of the view: of each column a
    `bayestissue.reports.pages.page_tables.Field` without its ``kind``.
    """

    by: tuple[str, ...]
    holds: str
    columns: dict[str, DeclaredColumn]
    looks: dict[str, dict[str, dict[str, Any]]]


@cache
def declared_files() -> dict[str, ResultFile]:
    """Every file of a result folder by its name."""
    content = declared(__package__, "tables.toml")
    return {name: _file(name, content) for name in content["files"]}


def _file(name: str, content: dict[str, Any]) -> ResultFile:
    entry = content["files"][name]
    means = entry.get("means", {})
    known = content["files"][means]["means"] if isinstance(means, str) else means
    columns, text, whole, may_lack = (
        entry.get(key, "").format_map(_GROUPS).split() for key in ("columns", "text", "whole", "may_lack")
    )
    of_outcomes = INTERVAL_MEANINGS if "{intervals of outcomes}" in entry.get("columns", "") else {}
    meanings = _OF_OUTCOMES | content["means"] | of_outcomes | known
    declared_columns = {
        column: DeclaredColumn(
            meanings[column],
            "text" if column in text else "whole" if column in whole else "number",
            column in may_lack,
        )
        for column in columns
    }
    looks = {}
    for view in ("shown", *entry.get("views", "").split()):
        stated = entry.get(view, {})
        if isinstance(stated, str):
            stated = {column: entry["shown"][column] for column in stated.split()}
        looks[view] = {column: {"title": column, "of": [column]} | look for column, look in stated.items()}
    return ResultFile(tuple(entry["by"]), entry["holds"], declared_columns, looks)


def columns_of(name: str) -> list[str]:
    """The columns of a table, in order; ``name`` is that of its file without suffix."""
    return list(declared_files()[f"{name}.csv"].columns)


def table_of_rows(name: str, rows: Iterable[Any] = ()) -> pd.DataFrame:
    """A table with the columns declared for ``name``; rows are tuples in their order, or mappings."""
    import pandas as pd

    return pd.DataFrame(list(rows), columns=columns_of(name))


def joined(name: str, parts: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Parts of the table ``name`` one below the other, its columns in order; empty where there are none.

    A column that parts lack is open.
    """
    import pandas as pd

    whole = pd.concat(parts, ignore_index=True) if parts else table_of_rows(name)
    return whole.reindex(columns=columns_of(name))


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


def as_text(cell: Any) -> Any:
    """A cell that a spreadsheet takes as it stands, whatever a name begins with.

    A spreadsheet computes what begins with =, +, - or @; with an apostrophe before it is text. Numbers stay;
    `as_written` is the way back.
    """
    return f"'{cell}" if isinstance(cell, str) and _is_computed(cell) else cell


def as_written(cell: str) -> str:
    """The text of a cell before `as_text`."""
    return cell[1:] if cell.startswith("'") and _is_computed(cell) else cell


def _is_computed(cell: str) -> bool:
    bare = cell.lstrip("'")
    return bare.startswith(("=", "+", "-", "@", "\t", "\r")) and not _NUMBER.fullmatch(bare)


def csv_text(table: pd.DataFrame) -> str:
    """A table, without its index, as every CSV file of the program has it: each text as of `as_text`."""
    texts = table.select_dtypes(exclude="number")
    computed = [name for name in texts if any(as_text(cell) is not cell for cell in texts[name])]
    shown = table.assign(**{str(name): texts[name].astype(object).map(as_text) for name in computed})
    return str(shown.rename(columns=as_text).to_csv(index=False, lineterminator="\n"))


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as a CSV file; see `csv_text`."""
    path.write_bytes(csv_text(table).encode())


def read_table(folder: Path, name: str) -> pd.DataFrame:
    """The table ``name`` of a folder, with text and numbers as of `typed`.

    Raises:
        InputError: the file lacks or can't be read, a column lacks, or a cell holds no number.
    """
    import pandas as pd

    path = folder / f"{name}.csv"
    if not path.is_file():
        raise InputError(wrong_in(path, HELD, value="no such file"))
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(wrong_in(path, "a table as a run writes it", value=type(error).__name__)) from error
    return typed(name, table.rename(columns=as_written).map(as_written), path)


def read_tables(folder: Path, names: Sequence[str], may_lack: Sequence[str] = ()) -> dict[str, pd.DataFrame]:
    """Several tables by name, those of ``may_lack`` only where they are.

    Raises:
        InputError: all the files that can't be read and all that is wrong in others, at once.
    """
    present = [*names, *(name for name in may_lack if (folder / f"{name}.csv").is_file())]
    return dict(zip(present, all_of(lambda name: read_table(folder, name), present), strict=True))
