"""A few lines on a large object: for a console, and for a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

from bayestissue.base.errors import printable

Rows = Sequence[tuple[str, str]]


class Outlined:
    """A large object that a console and a notebook show by a few lines."""

    def _outline(self) -> tuple[str, Rows]:
        """A title, and pairs of a name and words."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """The title, and under it a line for each row; nothing in it steers the terminal."""
        title, rows = self._outline()
        width = max(len(name) for name, _ in rows)
        lines = (f"  {name:{width}}  {printable(words)}" for name, words in rows)
        return "\n".join([printable(title), *lines])

    def _repr_html_(self) -> str:
        """The outline as an HTML table, every text of the user's escaped."""
        title, rows = self._outline()
        cells = "".join(
            f'<tr><th style="text-align:left">{escape(name)}</th>'
            f'<td style="text-align:left">{escape(printable(words))}</td></tr>'
            for name, words in rows
        )
        return f"<div><strong>{escape(printable(title))}</strong><table>{cells}</table></div>"


def short(text: str, most: int = 60) -> str:
    """Text cut to so many characters."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def span(values: ArrayLike, unit: str, digits: int = 4) -> str:
    """The least and the greatest of some values, which may be missing, with their unit."""
    import numpy as np

    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    if not known.size:
        return "not stated"
    low, high = (
        f"{value:.0f}" if value >= 10**digits else f"{value:.{digits}g}"
        for value in (known.min(), known.max())
    )
    return (f"{low} {unit}" if low == high else f"{low} to {high} {unit}").rstrip()


def numbers_in_short(values: Sequence[str], most: int = 4) -> str:
    """Numbers with commas between them; of many the first and the last, and how many there are."""
    return ", ".join(values) if len(values) <= most else f"{len(values)} from {values[0]} to {values[-1]}"


def counted(count: int, one: str, several: str = "") -> str:
    """A count with its noun: ``1 person``, ``3 people``; with an s unless it is said."""
    return f"{count} {one if count == 1 else several or f'{one}s'}"


def first_of(names: Sequence[str], most: int) -> str:
    """The first names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def markdown_rows(headings: tuple[str, ...], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a table in Markdown."""
    lines = [headings, ("---",) * len(headings), *rows]
    return ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines]
