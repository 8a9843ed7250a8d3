"""The cells of a table as text, such as those of `impacts.csv`, and what is wrong with columns and rows."""

from __future__ import annotations

import csv
import difflib
import io
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.base.declarations import declared
from bayestissue.base.errors import InputError, Problem, has_control_characters, refuse
from bayestissue.base.outline import counted
from bayestissue.base.results.tables import as_written
from bayestissue.recordings.dataset.dialect import NAMES, Dialect, text_table
from bayestissue.recordings.dataset.source_files import Source

FILE = "impacts.csv"
REMEDY = "Write one: a header and one row per impact; docs/how-to/write-a-dataset.md shows how."

# Columns of a height of fall, and how many metres their unit has.
HEIGHTS = {"drop_height_m": 1.0, "drop_height_cm": 1e-2, "drop_height_mm": 1e-3}
# The columns that a table of impacts is read by.
_STANDARD = (*declared(__package__, "columns.toml"), *HEIGHTS)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
# What the column "subject" may be called, in small letters.
_SUBJECTS = (
    *("patient", "participant", "person", "proband"),
    *("subject_id", "patient_id", "participant_id", "person_id"),
)


def is_height(name: str) -> bool:
    """Whether a column or a fact is a height of fall."""
    return name.startswith("drop_height")


def number_in(text: str) -> float:
    """The number that a cell holds, with a decimal point; not a number (nan) where it holds none."""
    return float(text) if _NUMBER.fullmatch(text) else math.nan


def with_subject(names: Sequence[str]) -> list[str]:
    """Names of columns with "subject" for `Subject`, `Patient` and the like, where there is one of these."""
    for words in ((), ("subject",), _SUBJECTS):
        candidates = [name for name in names if name.casefold() in words or name == "subject"]
        if len(candidates) == 1:
            return ["subject" if name == candidates[0] else name for name in names]
    return list(names)


def standard_names(names: Sequence[str]) -> list[str]:
    """Names of columns of `impacts.csv`, those of a standard column as it is written, in whatever case."""
    return in_case_of(_STANDARD, with_subject(names))


def in_case_of(standard: Iterable[str], names: Sequence[str]) -> list[str]:
    """Names, each of which differs from a standard one in case alone as that one; of several none."""
    known, small = {name.casefold(): name for name in standard}, [name.casefold() for name in names]
    pairs = zip(names, small, strict=True)
    return [known.get(one, name) if small.count(one) == 1 else name for name, one in pairs]


def ignoring_case(name: str, names: Iterable[str]) -> str:
    """The one of ``names`` that differs at most in case; the name itself where that is none, or several."""
    names = list(names)
    same = [one for one in names if one.casefold() == name.casefold()]
    return name if name in names or len(same) != 1 else same[0]


def in_whatever_case(name: str, columns: Iterable[str]) -> str:
    """The column that a name means, in whatever case or by a word for "subject"; itself if none is."""
    columns = list(columns)
    if with_subject([name]) == ["subject"] and not any(c.casefold() == name.casefold() for c in columns):
        return "subject" if "subject" in columns else name
    return ignoring_case(name, columns)


def nearest(name: str, columns: Sequence[str]) -> str:
    """The column that a name resembles most, in whatever case; empty where it resembles none."""
    small = {column.lower(): column for column in reversed(columns)}
    return next((small[near] for near in difflib.get_close_matches(name.lower(), small, n=1)), "")


def no_column(strange: Sequence[str], columns: Sequence[str]) -> str:
    """That there are no columns of these names, with those that are near, as a clause."""
    meant = ", ".join(filter(None, (nearest(name, columns) for name in strange)))
    return f"there is no column {', '.join(strange)}" + (f"; {meant} is near" if meant else "")


class Records(NamedTuple):
    """The records of a table as they were read.

    Attributes:
        names: of the columns.
        body: the cells of every record, without the spaces around them.
        lines: the row of each record.
        label: what messages call the table.
        dialect: how its file is written.
    """

    names: list[str]
    body: list[list[str]]
    lines: Sequence[int]
    label: str = FILE
    dialect: Dialect = Dialect()

    def cells(self, wanted: Sequence[str] = ()) -> tuple[pd.DataFrame, np.ndarray]:
        """All cells as text, and their rows; ``attrs["written"]`` of the table says how the file is written.

        Args:
            wanted: the columns that there must be.

        Raises:
            InputError: the names or the number of cells are wrong, or there is no record.
        """
        label, row, delimiter = self.label, self.dialect.header_row, self.dialect.delimiter
        names = standard_names(self.names) if "subject" in wanted else self.names
        problems = column_problems(label, names, wanted, row)
        problems += [p for p in column_problems(label, names, (), row) if p.column not in wanted]
        odd = {"control-characters": any(map(has_control_characters, names)), "empty": "" in names}
        listed = ", ".join(names)
        problems += [
            Problem.stated(f"column-names.{kind}", label, row, value=listed) for kind in odd if odd[kind]
        ]
        ragged = [
            (line, len(cells), delimiter.join(cells))
            for line, cells in zip(self.lines, self.body, strict=True)
            if len(cells) != len(names)
        ]
        problems += [ragged_problem(label, len(names), ragged, delimiter)] if ragged else []
        if not self.body:
            problems.append(Problem.stated("no-rows.impacts", label, value="no rows below the header"))
        refuse(problems)
        table = pd.DataFrame(self.body, columns=names, dtype=str)
        table.attrs["written"] = str(self.dialect)
        return table, np.array(self.lines)


def read_cells(
    source: Source, wanted: Sequence[str] = (), *, keep_empty: bool = False
) -> tuple[pd.DataFrame, np.ndarray]:
    """All cells as text without the spaces around them, numbers with a decimal point: see `Records.cells`.

    Args:
        source: the file. How recordings beside it are written decides of marks that can be read in two ways.
        wanted: the columns that it must have.
        keep_empty: whether a row of empty cells is a row; a line without any cell never is.

    Raises:
        InputError: the file can't be used: missing, too large, not UTF-8, no table, columns missing, or
            marks that can be read in two ways.
    """
    # Cells that are kept one by one take some twenty times their size.
    text = text_table(source.read(share=0.05), source, wanted=[*wanted, *NAMES], named=True)
    reader = csv.reader(
        io.StringIO(text.body.tobytes().decode(), newline=""), strict=True, delimiter=text.delimiter
    )
    above = text.dialect.first_row - 1
    text_names = standard_names(text.names) if "subject" in wanted else text.names
    body: list[list[str]] = []
    lines: list[int] = []
    try:
        for record in reader:
            cells = [
                as_written(cell.strip() if name in NAMES else text.dialect.plain(cell.strip()))
                for name, cell in zip_longest(text_names, record, fillvalue="")
            ][: len(record)]
            if any(cells) or (keep_empty and record):
                body.append(cells)
                lines.append(above + reader.line_num)
    except csv.Error as error:
        row, slip = above + reader.line_num, str(error)
        raise InputError.stated("cells-in-a-row.quotes", source.label, row=row, value=slip) from None
    names = list(map(as_written, text_names))
    # A spreadsheet writes empty columns where something once stood.
    width = max((at for at, name in enumerate(names, 1) if name), default=0)
    if not any(any(cells[width:]) for cells in body):
        names, body = names[:width], [cells[:width] for cells in body]
    return Records(names, body, lines, source.label, text.dialect).cells(wanted)


def column_problems(
    label: str, names: Sequence[str], wanted: Sequence[str], row: int = 1, *, stated: bool = False
) -> list[Problem]:
    """What is wrong with a header: columns that are missing or stand there twice.

    Args:
        label: what to call the file.
        names: the columns that it has.
        wanted: the columns that it must have.
        row: of the names; the first where there are none.
        stated: whether the row of the names can be stated.
    """
    problems, listed = [], ", ".join(names) or "no column names"
    for name in [name for name in wanted if name not in names]:
        numbered = re.compile(rf"{re.escape(name)} \(column \d+\)")
        if places := ", ".join(filter(numbered.fullmatch, names)):
            problems.append(Problem.stated("column-names.place", label, row or 1, name, name, names=places))
            continue
        near = nearest(name, names)
        case = " Capital and small letters differ." if near.lower() == name.lower() else ""
        hint: dict[str, Any] = {"alike": near, "case": case} if near else {}
        kind = "alike" if near else "recording" if stated else "none"
        problems.append(
            Problem.stated(f"missing-column.{kind}", label, row or 1, value=listed, name=name, **hint)
        )
    named = Counter(name for name in names if name and (name in wanted or not wanted))
    twice = [name for name, count in named.items() if count > 1]
    return problems + [Problem.stated("column-names.twice", label, row or 1, name, name) for name in twice]


def ragged_problem(
    label: str, columns: int, ragged: Sequence[tuple[int, int, str]], delimiter: str, header_row: int = 0
) -> Problem:
    """What is wrong with rows that have more or fewer cells than the header.

    Args:
        label: what to call the file.
        columns: how many there are.
        ragged: of each such row, at least one, its place, the number of its cells, and its text.
        delimiter: between cells.
        header_row: of a recording, whose row of names may have been found wrongly.
    """
    row, cells, text = ragged[0]
    comma = "; decimals need a point, not a comma, or quotes" if delimiter == "," else ""
    like_it = len(ragged) - 1
    more = f" {counted(like_it, 'more row is', 'more rows are')} like this." if like_it else ""
    words: dict[str, Any] = {"columns": counted(columns, "cell"), "comma": comma, "more": more}
    key = "cells-in-a-row.recording" if header_row else "cells-in-a-row.number"
    value = f"{cells} cells: {text}"
    return Problem.stated(key, label, row, value=value, header_row=header_row, **words)
