"""The names of columns, and what is wrong with them."""

from __future__ import annotations

import csv
import difflib
from collections import Counter
from collections.abc import Sequence

from bayestissue.dataset.files import first_line, require_utf8
from bayestissue.errors import Problem


def column_problems(label: str, names: Sequence[str], wanted: Sequence[str]) -> list[Problem]:
    """What is wrong with a header: columns that are missing or stand there twice.

    Args:
        label: what to call the file.
        names: the columns that it has.
        wanted: the columns that it must have.
    """
    problems = []
    for name in [name for name in wanted if name not in names]:
        written = {other.lower(): other for other in reversed(names)}
        near = difflib.get_close_matches(name.lower(), list(written), n=1)
        hint = f'Rename "{written[near[0]]}" to "{name}".' if near else f'Add a column "{name}".'
        if near == [name.lower()]:
            hint = f"{hint} Capital and small letters differ."
        if len(names) == 1 and ";" in names[0]:
            hint = "Save the file with commas between the cells and points in the numbers."
        problems.append(
            Problem(
                label,
                f'a column "{name}"',
                hint,
                row=1,
                value=", ".join(names) or "no column names",
                code="missing-column",
            )
        )
    twice = [name for name, count in Counter(names).items() if count > 1 and (name in wanted or not wanted)]
    problems += [
        Problem(
            label,
            "every column name once",
            "Remove or rename one of the two.",
            row=1,
            column=name,
            value=name,
            code="column-names",
        )
        for name in twice
    ]
    return problems


def header(data: bytes, label: str) -> list[str]:
    """The column names of a CSV file, without the spaces around them.

    Raises:
        InputError: the text is not UTF-8, or has no line of names.
    """
    first = first_line(data, label)
    require_utf8(data, label)
    return [name.strip() for name in next(csv.reader([first.decode()]), [])]
