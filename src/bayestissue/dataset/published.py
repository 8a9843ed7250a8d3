"""The thesis's published tables, read with the digits that were printed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.declarations import declared
from bayestissue.errors import Problem, refuse
from bayestissue.resources import shared

_CONDITION = ("energy_J", "velocity_m_s", "mass_kg")
# What a cell of each kind holds, and how that shows in its text and number (not a number where it is none).
_KINDS: dict[str, tuple[str, Callable[[pd.Series, pd.Series], pd.Series]]] = {
    "whole": ("a whole number", lambda text, value: (value == value.round()) & np.isfinite(value)),
    "positive": ("a number above zero", lambda text, value: (value > 0) & np.isfinite(value)),
    "number": ("a number", lambda text, value: np.isfinite(value)),
    "optional": ("a number or nothing", lambda text, value: np.isfinite(value) | (text.str.strip() == "")),
    "name": ("a name", lambda text, value: text.str.strip() != ""),
    "response": ("K or C", lambda text, value: text.isin(["K", "C"])),
    "status": ("entered or not entered", lambda text, value: text.isin(["entered", "not entered"])),
}
# Of numbers of these kinds the digits that were printed are kept.
_PRINTED = ("positive", "number", "optional")


# The columns of each file by what they hold, and the key that tells its rows apart.
_LAYOUTS = declared(__package__, "published.toml")


@dataclass(frozen=True)
class PublishedTables:
    """Chapter 5 to 7 of the thesis as tables; one row of a table is one printed row.

    Numbers are float64, counts (``trial``, ``subject``, ``row``, ``claim``) are int64, names are text, and
    beside every printed number ``X`` stands its text ``X_text``, which tells how many digits were published.

    Attributes:
        estimates: the 70 impacts of Tables 5.2 to 5.6, 5.8 and 5.9 (J, m/s, kg; K and C as printed).
        averages: Tables 5.10 and 5.11, one row per trial and quantity.
        correlations: Tables 5.12, 5.14 and 5.15; ``p_value`` is NaN where none was printed.
        stepwise: Table 5.17, one row per variable and quantity.
        regressions: the two regression equations of section 5.4, one row per term.
        claims: the numbers claimed in the running text, each with its sentence.
        folder: where the tables were read.
        paths: the files read.
    """

    estimates: pd.DataFrame
    averages: pd.DataFrame
    correlations: pd.DataFrame
    stepwise: pd.DataFrame
    regressions: pd.DataFrame
    claims: pd.DataFrame
    folder: Path
    paths: tuple[Path, ...]


def read_published(folder: Path | None = None) -> PublishedTables:
    """Read the published tables of ``folder``, or those that come with the program.

    Raises:
        InputError: a file or a column is missing, a cell isn't the number or name it should be, a row stands
            twice, or the impacts of a trial disagree on its condition; all of it listed at once.
    """
    folder = shared("data", "published") if folder is None else Path(folder)
    problems: list[Problem] = []
    paths = {name: folder / f"{name}.csv" for name in _LAYOUTS}
    tables = {name: _read_table(paths[name], name, problems) for name in _LAYOUTS}
    if not problems:
        problems += _conditions_that_disagree(tables["estimates"], tables["averages"], paths)
    refuse(problems)
    return PublishedTables(**tables, folder=folder, paths=tuple(paths.values()))


def _read_table(path: Path, name: str, problems: list[Problem]) -> pd.DataFrame:
    layout = _LAYOUTS[name]
    kinds = {column: kind for kind, columns in layout.items() if kind != "key" for column in columns}
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8").fillna("")
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        problems.append(_wrong(path, "a readable CSV table", value=type(error).__name__))
        return pd.DataFrame()
    # pandas takes the first cells of rows that are longer than the header for row names.
    if not isinstance(table.index, pd.RangeIndex):
        problems.append(_wrong(path, "as many cells in a row as in the header"))
    elif missing := [column for column in kinds if column not in table]:
        problems += [_wrong(path, "this column", row=1, column=column) for column in missing]
    elif table.empty:
        problems.append(_wrong(path, "at least one row"))
    else:
        for column in kinds:
            problems += _read_column(table, column, kinds[column], path)
        problems += _rows_that_stand_twice(table, layout["key"], path)
    return table


def _read_column(table: pd.DataFrame, column: str, kind: str, path: Path) -> list[Problem]:
    """Turn a ``column`` of numbers into such, keep what was printed beside it, and list what isn't one."""
    expected, good = _KINDS[kind]
    text = table[column]
    values = pd.to_numeric(text.str.strip(), errors="coerce").astype("float64")
    bad = ~good(text, values)
    if kind in _PRINTED:
        table[f"{column}_text"] = text.str.strip()
    if kind in (*_PRINTED, "whole"):
        table[column] = values.astype("int64") if kind == "whole" and not bad.any() else values
    return [
        _wrong(path, expected, row=_line(index), column=column, value=text[index])
        for index in table.index[bad]
    ]


def _rows_that_stand_twice(table: pd.DataFrame, key: list[str], path: Path) -> list[Problem]:
    names = ", ".join(key)
    return [
        Problem.stated(
            "published-table.twice",
            str(path),
            _line(index),
            key[-1],
            ", ".join(map(str, cells)),
            columns=names,
        )
        for index, *cells in table.loc[table.duplicated(key), key].itertuples()
    ]


def _conditions_that_disagree(
    estimates: pd.DataFrame, averages: pd.DataFrame, paths: dict[str, Path]
) -> list[Problem]:
    """Energy, velocity and mass belong to the trial: whatever groups by trial relies on it."""
    first = averages.drop_duplicates("trial").set_index("trial")[list(_CONDITION)]
    problems = []
    for path, table in ((paths["estimates"], estimates), (paths["averages"], averages)):
        for column in _CONDITION:
            expected = table["trial"].map(first[column])
            for index in table.index[table[column] != expected]:
                words = f"averages of trial {table.loc[index, 'trial']} in averages.csv"
                if np.isfinite(expected[index]):
                    words = f"{expected[index]:g}, the first that averages.csv has for the trial"
                where = {"row": _line(index), "column": column, "value": table.loc[index, column]}
                problems.append(_wrong(path, words, **where))
    return problems


def _line(index: Any) -> int:
    return int(index) + 2


def _wrong(path: Path, expected: str, **where: Any) -> Problem:
    return Problem.stated("published-table.other", str(path), expected=expected, **where)
