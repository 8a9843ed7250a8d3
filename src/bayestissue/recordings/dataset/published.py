"""The thesis's published tables, read with the digits that were printed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from bayestissue.base.declarations import declared
from bayestissue.base.resources import shared

# Of each file the columns of whole numbers, and those of printed numbers, whose digits are kept.
_LAYOUTS = declared(__package__, "published.toml")


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
        paths: the files read.
    """

    estimates: pd.DataFrame
    averages: pd.DataFrame
    correlations: pd.DataFrame
    stepwise: pd.DataFrame
    regressions: pd.DataFrame
    claims: pd.DataFrame
    paths: tuple[Path, ...]


def read_published() -> PublishedTables:
    """Read the published tables, which come with the program."""
    paths = {name: shared("data", "published", f"{name}.csv") for name in _LAYOUTS}
    tables = {name: _read_table(path, _LAYOUTS[name]) for name, path in paths.items()}
    return PublishedTables(**tables, paths=tuple(paths.values()))


def _read_table(path: Path, layout: dict[str, list[str]]) -> pd.DataFrame:
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    for column in layout["printed"]:
        table[f"{column}_text"] = table[column]
        table[column] = pd.to_numeric(table[column]).astype("float64")
    return table.astype(dict.fromkeys(layout["whole"], "int64"))
