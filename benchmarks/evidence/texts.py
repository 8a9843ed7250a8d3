"""A figure of the documentation, and how numbers and tables are written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import pandas as pd

from evidence.registry import BENCHMARKS, of_family, pieces
from evidence.status import EARLIER, state_of

LEVELS = (50, 90)
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Figure:
    """A text of the documentation, and the pieces of evidence that it tells."""

    text: str
    pieces: tuple[str, ...]
    # Tables and paragraphs of their own; others stand within a sentence.
    block: bool = False

    def printed(self) -> str:
        """With a remark where a piece is stale."""
        stale = [name for name in self.pieces if state_of(pieces()[name]).kind != "fresh"]
        if not stale:
            return self.text
        if not self.block:
            return f"{self.text} ({EARLIER})"
        which = "" if len(stale) == len(self.pieces) else f": {', '.join(stale)}"
        return f"{self.text}\n\n*{EARLIER[0].upper()}{EARLIER[1:]}{which}.*"


Named = Iterator[tuple[str, Figure]]
# What makes the figures of each family of pieces, by its name.
FAMILIES: dict[str, Callable[[], Named]] = {}


def family(function: Callable[[], Named]) -> Callable[[], Named]:
    """Let a function make the figures of the family that it is called after."""
    FAMILIES[function.__name__] = function
    return function


def read(name: str) -> pd.DataFrame:
    """A result file."""
    return pd.read_csv(BENCHMARKS / name)


def table(rows: pd.DataFrame, *, words: bool = False) -> str:
    """As Markdown: the first column to the left, or all of ``words``; empty where a cell is missing."""
    aligned = ["---", *["---" if words else "---:"] * (rows.shape[1] - 1)]
    head = [" | ".join(map(str, rows.columns)), " | ".join(aligned)]
    cells = rows.astype(object).where(rows.notna(), "").astype(str)
    return "\n".join(f"| {line} |" for line in [*head, *(" | ".join(row) for row in cells.to_numpy())])


def power_of_ten(value: float) -> str:
    """Such as 3 · 10⁻⁹."""
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa} · 10{str(int(exponent)).translate(_RAISED)}"


def percent(share: float, digits: int = 1) -> str:
    """A share."""
    return f"{100 * share:.{digits}f} %"


def with_error(share: pd.Series, error: pd.Series) -> list[str]:
    """Shares and their standard errors, in percent."""
    return [f"{100 * each:.1f} ± {100 * sd:.1f} %" for each, sd in zip(share, error, strict=True)]


def names(family: str) -> tuple[str, ...]:
    """The pieces of a family."""
    return tuple(piece.name for piece in of_family(family))


def block(text: str, family: str) -> Figure:
    """Of all pieces of a family."""
    return Figure(text, names(family), block=True)


def in_order(lines: pd.DataFrame, column: str, order: Iterable[str]) -> pd.DataFrame:
    """Rows in the order in which the registry has their pieces."""
    place = list(order).index
    return lines.sort_values(column, key=lambda values: values.map(place), kind="stable")


def coverage(lines: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Of each quantity: how often the intervals held it, how far off the median, how wide the widest."""
    lines = lines.assign(cell=with_error(lines["share"], lines["campaign_se"]))
    cells = lines.pivot_table("cell", by, "level", "first", sort=False).rename(columns="{} % held".format)
    widest = lines[lines["level"] == lines["level"].max()].set_index(by)
    cells["off by"], cells["90 % width"] = widest["median_error"], widest["median_width"]
    return cells.reset_index().rename_axis(columns=None)


def range_of_shares(lines: pd.DataFrame) -> str:
    """The least and the greatest share held, by level."""
    ends = lines.groupby("level")["share"].agg(["min", "max"]).itertuples()
    return " and ".join(f"{level} % intervals held {100 * a:.0f} to {100 * b:.0f} %" for level, a, b in ends)


def each_held(lines: pd.DataFrame, family: str, column: str) -> Named:
    """The share held of each quantity and level, named VALUE_QUANTITY_LEVEL."""
    for row in lines.itertuples():
        value = getattr(row, column)
        yield f"{value}_{row.quantity}_{row.level}", Figure(percent(row.share), (f"{family}-{value}",))
