"""The cells of `impacts.csv`, as text."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.dataset.dialect import text_table
from bayestissue.dataset.files import read_bytes
from bayestissue.dataset.headers import RaggedRow, column_problems, ragged_problem
from bayestissue.errors import InputError, Problem, has_control_characters, refusal

FILE = "impacts.csv"
# Columns of names, where "1,5" is no number.
NAMES = ("impact", "subject", "trial", "trace", "file")


def read_cells(
    path: Path,
    wanted: Sequence[str],
    *,
    label: str = FILE,
    keep_empty: bool = False,
    remedy: str = "Write one: a header and one row per impact; docs/how-to/write-a-dataset.md shows how.",
) -> tuple[pd.DataFrame, np.ndarray]:
    """All cells as text without the spaces around them, numbers with a decimal point, and their rows.

    The table's ``attrs["written"]`` says how the file is written.

    Args:
        path: the file.
        wanted: the columns that it must have.
        label: what messages call it.
        keep_empty: whether a row of empty cells is a row; a line without any cell never is.
        remedy: what to do if it is not there.

    Raises:
        InputError: the file can't be used: missing, too large, not UTF-8, no table, columns missing.
    """
    # Cells that are kept one by one take some twenty times their size.
    data = read_bytes(path, label, remedy, share=0.05)
    text = text_table(data, label, wanted=[*wanted, *NAMES], named=True)
    reader = csv.reader(
        io.StringIO(text.body.tobytes().decode(), newline=""), strict=True, delimiter=text.delimiter
    )
    above = text.dialect.first_row - 1
    body: list[list[str]] = []
    lines: list[int] = []
    try:
        for record in reader:
            cells = [
                cell.strip() if name in NAMES else text.dialect.plain(cell.strip())
                for name, cell in zip_longest(text.names, record, fillvalue="")
            ][: len(record)]
            if any(cells) or (keep_empty and record):
                body.append(cells)
                lines.append(above + reader.line_num)
    except csv.Error as error:
        raise refusal(
            label,
            "cells separated by one mark, and quotes that match",
            "Mend the quotes in this row.",
            above + reader.line_num,
            value=str(error),
            code="cells-in-a-row",
        ) from None
    names = text.names
    # A spreadsheet writes empty columns where something once stood.
    width = max((at for at, name in enumerate(names, 1) if name), default=0)
    if not any(any(cells[width:]) for cells in body):
        names, body = names[:width], [cells[:width] for cells in body]
    table, rows = cells_of(
        names, body, lines, wanted, label=label, row=text.dialect.header_row, delimiter=text.delimiter
    )
    table.attrs["written"] = str(text.dialect)
    return table, rows


def cells_of(
    names: list[str],
    body: list[list[str]],
    lines: Sequence[int],
    wanted: Sequence[str],
    *,
    label: str = FILE,
    row: int = 1,
    delimiter: str = ",",
) -> tuple[pd.DataFrame, np.ndarray]:
    """The cells of records that were read already.

    Args:
        names: of the columns.
        body: the cells of every record, without the spaces around them.
        lines: the row of each record.
        wanted: the columns that there must be.
        label: what messages call the table.
        row: of the names.
        delimiter: between the cells of the file.

    Raises:
        InputError: the names or the number of cells are wrong, or there is no record.
    """
    problems = column_problems(label, names, wanted, row)
    problems += [p for p in column_problems(label, names, (), row) if p.column not in wanted]
    if any(has_control_characters(name) for name in names):
        expected = "names of columns on one line and without control characters"
        problems.append(
            Problem(
                label, expected, "Rename the column.", row=row, value=", ".join(names), code="column-names"
            )
        )
    if "" in names:
        problems.append(
            Problem(
                label,
                "a name over every column",
                "Name the column or remove it.",
                row=row,
                value=", ".join(names),
                code="column-names",
            )
        )
    ragged = [
        RaggedRow(line, len(cells), delimiter.join(cells))
        for line, cells in zip(lines, body, strict=True)
        if len(cells) != len(names)
    ]
    problems += [ragged_problem(label, len(names), ragged, delimiter)] if ragged else []
    if not body:
        problems.append(
            Problem(
                label,
                "one row per impact",
                "Add the impacts.",
                value="no rows below the header",
                code="no-rows",
            )
        )
    if problems:
        raise InputError(problems)
    return pd.DataFrame(body, columns=names, dtype=str), np.array(lines)


def control_characters(cells: pd.DataFrame, rows: np.ndarray) -> list[Problem]:
    """Cells that a terminal would obey, or that run over several lines; as `read_cells` returns them."""
    return [
        Problem(
            FILE,
            "text on one line and without control characters",
            "Type the cell anew.",
            row=int(row),
            column=name,
            value=text,
            impact=impact or None,
            code="control-characters",
        )
        for name in cells.columns
        for text, row, impact in zip(cells[name], rows, cells["impact"], strict=True)
        if has_control_characters(text)
    ]
