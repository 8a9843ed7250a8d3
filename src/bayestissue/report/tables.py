"""Tables as a template wants them: columns that know how they are set, rows that know how they are marked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd
from markupsafe import Markup


@dataclass(frozen=True)
class Column:
    """A heading and how its cells are set: ``"text"``, ``"number"`` (to the right) or ``"words"``."""

    title: str
    kind: str = "text"


@dataclass(frozen=True)
class Row:
    """The cells of one row; ``mark`` is a class of the style sheet, such as ``"disagrees"``."""

    cells: Sequence[str]
    mark: str = ""
    anchor: str = ""


@dataclass(frozen=True)
class Table:
    """A whole table; cells are text, or `Markup` where they hold more than text."""

    columns: Sequence[Column]
    rows: Sequence[Row] = field(default_factory=tuple)


@dataclass(frozen=True)
class Field:
    """A column with what makes its cell of a row of the data; ``kind`` as of `Column`."""

    title: str
    cell: Callable[[Any], str]
    kind: str = "text"


def table_of(rows: Iterable[Any], *fields: Field, mark: Callable[[Any], str] = lambda row: "") -> Table:
    """A table with a row for each of ``rows``, and a cell in it for each of ``fields``."""
    return Table(
        [Column(field.title, field.kind) for field in fields],
        [Row(tuple(field.cell(row) for field in fields), mark(row)) for row in rows],
    )


def columns(*titles: str, number: Sequence[str] = (), words: Sequence[str] = ()) -> tuple[Column, ...]:
    """One column a title; those in ``number`` are set to the right, those in ``words`` may grow wide."""
    return tuple(
        Column(title, "number" if title in number else "words" if title in words else "text")
        for title in titles
    )


def lines(frame: pd.DataFrame) -> list[Any]:
    """The rows of ``frame`` as named tuples, whose fields are the columns and ``Index``."""
    return list(frame.itertuples())


def tag(kind: str, words: str) -> Markup:
    """``words`` as a small coloured label; ``kind`` is a class of the style sheet, such as ``"major"``."""
    return Markup('<span class="tag {}">{}</span>').format(kind, words)
