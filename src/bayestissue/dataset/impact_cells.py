"""The cells of `impacts.csv`, as text."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.dataset.files import read_bytes, require_utf8
from bayestissue.dataset.headers import column_problems
from bayestissue.errors import InputError, Problem, has_control_characters

FILE = "impacts.csv"


def read_cells(
    path: Path,
    wanted: Sequence[str],
    *,
    label: str = FILE,
    remedy: str = "Write one: a header and one row per impact; docs/how-to/write-a-dataset.md shows how.",
) -> tuple[pd.DataFrame, np.ndarray]:
    """All cells as text without the spaces around them, and of each record its row in the file.

    Args:
        path: the file.
        wanted: the columns that it must have.
        label: what messages call it.
        remedy: what to do if it is not there.

    Raises:
        InputError: the file can't be used: missing, too large, not UTF-8, no table, columns missing.
    """
    # Cells that are kept one by one take some twenty times their size.
    data = read_bytes(path, label, remedy, share=0.05)
    require_utf8(data, label)
    reader = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
    records: list[list[str]] = []
    lines: list[int] = []
    try:
        for record in reader:
            cells = [cell.strip() for cell in record]
            if any(cells):
                records.append(cells)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise InputError(
            Problem(
                label,
                "cells separated by commas",
                "Mend the quotes in this row.",
                reader.line_num,
                value=str(error),
                code="cells-in-a-row",
            )
        ) from None
    names, *body = records
    return cells_of(names, body, lines[1:], wanted, label=label)


def cells_of(
    names: list[str],
    body: list[list[str]],
    lines: Sequence[int],
    wanted: Sequence[str],
    *,
    label: str = FILE,
) -> tuple[pd.DataFrame, np.ndarray]:
    """The same of records that were read already.

    Args:
        names: of the columns.
        body: the cells of every record, without the spaces around them.
        lines: the row of each record.
        wanted: the columns that there must be.
        label: what messages call the table.

    Raises:
        InputError: the names or the number of cells are wrong, or there is no record.
    """
    problems = column_problems(label, names, wanted)
    problems += [p for p in column_problems(label, names, ()) if p.column not in wanted]
    if any(has_control_characters(name) for name in names):
        expected = "names of columns on one line and without control characters"
        problems.append(
            Problem(label, expected, "Rename the column.", row=1, value=", ".join(names), code="column-names")
        )
    if "" in names:
        problems.append(
            Problem(
                label,
                "a name over every column",
                "Name the column or remove it.",
                row=1,
                value=", ".join(names),
                code="column-names",
            )
        )
    problems += [
        Problem(
            label,
            f"{len(names)} cells as in the header",
            "Put one cell under every column name; decimals need a point, not a comma.",
            row=line,
            value=f"{len(cells)} cells: {','.join(cells)}",
            code="cells-in-a-row",
        )
        for line, cells in zip(lines, body, strict=True)
        if len(cells) != len(names)
    ]
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
