"""The table of new impacts that predictions are asked for, read and checked cell by cell."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.dataset.cells import cells_of, read_cells
from bayestissue.errors import InputError, Problem, has_control_characters
from bayestissue.hierarchy.levels import Condition, Recorded

_POSITIVE = {"mass_kg": "kg", "velocity_m_s": "m/s", "diameter_m": "m"}
_LARGEST = 1e4
_LABEL = "impact"
_TABLE = "table (rows from 0)"
_in_table = partial(Problem, code="prediction-table")


def read_conditions(table: str | Path | pd.DataFrame, recorded: Recorded) -> list[Condition]:
    """What is given of each new impact, by column; an empty cell is not given, also where all of a row are.

    Args:
        table: a CSV file or a pandas table, whose columns are among those of the run's ``impacts.csv``.
            ``impact`` may name the rows.
        recorded: of the run.

    Raises:
        InputError: everything that is wrong, with file, row, column, value and what was expected.
    """
    if isinstance(table, pd.DataFrame):
        label, first = _TABLE, 0
        body = [[_text(value) for value in row] for row in table.itertuples(index=False, name=None)]
        cells, rows = cells_of([str(n) for n in table], body, range(first, len(body)), (), label=label)
    else:
        label = str(table)
        remedy = "Write one: a header with columns of impacts.csv, and a row for each new impact."
        cells, rows = read_cells(Path(table), (), label=label, keep_empty=True, remedy=remedy)
    if problems := [*_columns(cells, recorded, label), *_lacking(recorded, label)]:
        raise InputError(problems)
    if problems := list(_wrong(cells, rows, recorded, label)):
        raise InputError(problems)
    return [
        {
            str(name): float(text) if _is_number(str(name), recorded) else text
            for name, text in zip(cells, texts, strict=True)
            if text
        }
        for texts in cells.itertuples(index=False, name=None)
    ]


def _text(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)) or value is pd.NA:
        return ""
    if isinstance(value, float | np.floating):
        return f"{float(value):.17g}"
    return str(value).strip()


def _usable(recorded: Recorded) -> list[str]:
    return list(dict.fromkeys([*map(str, recorded.rows), *_POSITIVE]))


def _is_number(name: str, recorded: Recorded) -> bool:
    return name in _POSITIVE or (name in recorded.rows and name not in recorded.named)


def _columns(cells: pd.DataFrame, recorded: Recorded, label: str) -> Iterator[Problem]:
    usable = _usable(recorded)
    for name in map(str, cells):
        if name not in (*usable, _LABEL):
            near = difflib.get_close_matches(name, usable, n=1)
            remedy = f'Is it "{near[0]}"?' if near else "Rename or remove the column."
            expected = f"columns of the run: {', '.join(usable)}"
            yield _in_table(label, expected, remedy, row=1, column=name, value=name)


def _lacking(recorded: Recorded, label: str) -> Iterator[Problem]:
    expected, remedy = "a run that keeps this column", "Fit again with this version."
    for name in recorded.lacking:
        yield Problem(label, expected, remedy, column=name, code="damaged-run")


def _wrong(cells: pd.DataFrame, rows: np.ndarray, recorded: Recorded, label: str) -> Iterator[Problem]:
    for name in map(str, cells):
        known = recorded.levels(name) if name in recorded.named and not recorded.may_be_new(name) else None
        for text, row in zip(cells[name], rows, strict=True):
            expected, remedy = "", "Correct the cell, or leave it empty."
            if has_control_characters(text):
                expected = "text on one line and without control characters"
            elif text and name != _LABEL and _is_number(name, recorded):
                expected = _no_number(name, text)
            elif text and name != _LABEL and known is not None and text not in known:
                expected = f"one of {', '.join(known[:8])}"
                near = difflib.get_close_matches(text, known, n=1)
                remedy = f'Is it "{near[0]}"? {remedy}' if near else remedy
            if expected:
                yield _in_table(label, expected, remedy, row=int(row), column=name, value=text)


def _no_number(name: str, text: str) -> str:
    """What was expected of a cell that should hold a number; empty where it does."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if name in _POSITIVE:
        good = 0 < value < _LARGEST
        return "" if good else f"a number of {_POSITIVE[name]} above 0 and below {_LARGEST:g}"
    return "" if math.isfinite(value) else "a number"
