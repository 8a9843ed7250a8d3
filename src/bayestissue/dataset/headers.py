"""The names of columns and the cells below them: what is wrong with their number."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from bayestissue.errors import Problem


def column_problems(label: str, names: Sequence[str], wanted: Sequence[str], row: int = 1) -> list[Problem]:
    """What is wrong with a header: columns that are missing or stand there twice.

    Args:
        label: what to call the file.
        names: the columns that it has.
        wanted: the columns that it must have.
        row: of the names; the first where there are none.
    """
    problems = []
    for name in [name for name in wanted if name not in names]:
        written = {column.lower(): column for column in reversed(names)}
        near = difflib.get_close_matches(name.lower(), list(written), n=1)
        hint = f'Rename "{written[near[0]]}" to "{name}".' if near else f'Add a column "{name}".'
        if near == [name.lower()]:
            hint = f"{hint} Capital and small letters differ."
        problems.append(
            Problem(
                label,
                f'a column "{name}"',
                hint,
                row=row or 1,
                value=", ".join(names) or "no column names",
                code="missing-column",
            )
        )
    twice = [
        name
        for name, count in Counter(names).items()
        if count > 1 and name and (name in wanted or not wanted)
    ]
    problems += [
        Problem(
            label,
            "every column name once",
            "Remove or rename one of the two.",
            row=row or 1,
            column=name,
            value=name,
            code="column-names",
        )
        for name in twice
    ]
    return problems


@dataclass(frozen=True)
class RaggedRow:
    """A row with more or fewer cells than there are columns: its place, their number, and its text."""

    row: int
    cells: int
    text: str


def ragged_problem(label: str, columns: int, ragged: Sequence[RaggedRow], delimiter: str) -> Problem:
    """What is wrong with rows that have more or fewer cells than the header.

    Args:
        label: what to call the file.
        columns: how many there are.
        ragged: the rows, at least one.
        delimiter: between cells.
    """
    first = ragged[0]
    comma = "; decimals need a point, not a comma, or quotes" if delimiter == "," else ""
    more = f" {len(ragged) - 1} more rows are like this." if len(ragged) > 1 else ""
    return Problem(
        label,
        f"{columns} cell{'s' if columns > 1 else ''} as in the header",
        f"Put one cell under every column name{comma}.{more}",
        row=first.row,
        value=f"{first.cells} cells: {first.text}",
        code="cells-in-a-row",
    )
