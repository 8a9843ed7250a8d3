"""The thesis's published tables, read with the digits that were printed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.errors import InputError, Problem
from bayestissue.resources import shared

_MEND = "Compare the file with data/published, which comes with the program."
_wrong = partial(Problem, code="published-table")


@dataclass(frozen=True)
class _Layout:
    """Columns of one file, by what they hold."""

    integers: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    positive: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    may_be_empty: tuple[str, ...] = ()
    key: tuple[str, ...] = ()

    @property
    def printed(self) -> tuple[str, ...]:
        return self.positive + self.numbers + self.may_be_empty

    @property
    def columns(self) -> tuple[str, ...]:
        return self.integers + self.labels + self.printed


_CONDITION = ("energy_J", "velocity_m_s", "mass_kg")
_LAYOUTS = {
    "estimates": _Layout(
        integers=("row", "trial", "subject"),
        labels=("table",),
        positive=(*_CONDITION, "K", "C"),
        key=("trial", "subject"),
    ),
    "averages": _Layout(
        integers=("row", "trial"),
        labels=("table", "quantity"),
        positive=(*_CONDITION, "average", "sd", "range"),
        key=("quantity", "trial"),
    ),
    "correlations": _Layout(
        integers=("row",),
        labels=("table", "variable", "quantity"),
        numbers=("correlation",),
        may_be_empty=("p_value",),
        key=("table", "row"),
    ),
    "stepwise": _Layout(
        integers=("row",),
        labels=("table", "quantity", "status", "variable"),
        key=("table", "quantity", "status", "row"),
    ),
    "regressions": _Layout(
        labels=("quantity", "term"), numbers=("coefficient", "r_squared"), key=("quantity", "term")
    ),
    "claims": _Layout(
        integers=("claim",),
        labels=("section", "quantity", "statistic", "sentence"),
        numbers=("value",),
        key=("claim",),
    ),
}
_ALLOWED = {"status": ("entered", "not entered")}
_K_OR_C = ("averages", "correlations", "stepwise", "regressions")


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
    if problems:
        raise InputError(problems)
    return PublishedTables(**tables, folder=folder, paths=tuple(paths.values()))


def _read_table(path: Path, name: str, problems: list[Problem]) -> pd.DataFrame:
    layout = _LAYOUTS[name]
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8").fillna("")
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        problems.append(_wrong(str(path), "a readable CSV table", _MEND, value=type(error).__name__))
        return pd.DataFrame()
    # pandas takes the first cells of rows that are longer than the header for row names.
    if not isinstance(table.index, pd.RangeIndex):
        problems.append(_wrong(str(path), "as many cells in a row as in the header", _MEND))
        return table
    missing = [column for column in layout.columns if column not in table]
    if missing or table.empty:
        problems += [_wrong(str(path), "this column", _MEND, row=1, column=column) for column in missing] or [
            _wrong(str(path), "at least one row", _MEND)
        ]
        return table
    faults = _wrong_labels(table, path, name)
    for column in layout.integers + layout.printed:
        faults += _read_column(table, column, layout, path)
    faults += _rows_that_stand_twice(table, layout, path)
    problems += faults
    return table


def _read_column(table: pd.DataFrame, column: str, layout: _Layout, path: Path) -> list[Problem]:
    """Turn ``column`` of ``table`` into numbers, keep what was printed beside it, and list what isn't one."""
    text = table[column].str.strip()
    values = pd.to_numeric(text, errors="coerce").astype("float64")
    bad = ~np.isfinite(values)
    expected = "a number"
    if column in layout.may_be_empty:
        bad &= text != ""
        expected = "a number or nothing"
    if column in layout.positive:
        bad |= ~(values > 0)
        expected = "a number above zero"
    if column in layout.integers:
        bad |= values != values.round()
        expected = "a whole number"
    if column in layout.printed:
        table[f"{column}_text"] = text
    table[column] = values if column in layout.printed or bad.any() else values.astype("int64")
    return [
        _wrong(str(path), expected, _MEND, row=_line(index), column=column, value=text[index])
        for index in table.index[bad]
    ]


def _wrong_labels(table: pd.DataFrame, path: Path, name: str) -> list[Problem]:
    allowed = dict(_ALLOWED, quantity=("K", "C")) if name in _K_OR_C else _ALLOWED
    problems = []
    for column in _LAYOUTS[name].labels:
        wrong = table[column].str.strip() == ""
        expected = "a name"
        if column in allowed:
            wrong = ~table[column].isin(allowed[column])
            expected = " or ".join(allowed[column])
        problems += [
            _wrong(str(path), expected, _MEND, row=_line(index), column=column, value=value)
            for index, value in table.loc[wrong, column].items()
        ]
    return problems


def _rows_that_stand_twice(table: pd.DataFrame, layout: _Layout, path: Path) -> list[Problem]:
    keys = list(layout.key)
    expected, remedy = f"each {', '.join(keys)} once", "Take one of the two rows out, or mend its key."
    return [
        _wrong(str(path), expected, remedy, row=_line(index), column=keys[-1], value=", ".join(map(str, key)))
        for index, *key in table.loc[table.duplicated(keys), keys].itertuples()
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
                problems.append(
                    _wrong(
                        str(path),
                        words,
                        _MEND,
                        row=_line(index),
                        column=column,
                        value=table.loc[index, column],
                    )
                )
    return problems


def _line(index: Any) -> int:
    return int(index) + 2
