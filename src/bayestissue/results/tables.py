"""The tables of a result folder: written for programs, or as a spreadsheet opens them; read either way."""

from __future__ import annotations

import locale
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import pandas as pd

# The decimal mark of the spreadsheet; "auto" stands for that of the machine's language and country.
Excel = Literal["auto", "comma", "point"]
_MARK = "\ufeff"
_WITH_COMMA = r"([+-]?\d+(,\d+)?([eE][+-]?\d+)?|nan|[+-]?inf)?"


def write_table(table: pd.DataFrame, path: Path, excel: Excel | None = None) -> None:
    """Write a CSV file.

    Args:
        table: without its index.
        path: of the file.
        excel: None for programs: UTF-8, commas, decimal points. Else as a spreadsheet with this decimal mark
            opens it by itself: UTF-8 with a mark, and between cells semicolons beside decimal commas.
    """
    if excel is None:
        table.to_csv(path, index=False)
        return
    decimal = {"comma": ",", "point": "."}.get(excel) or _decimal_here()
    separator = ";" if decimal == "," else ","
    table.to_csv(
        path, index=False, encoding="utf-8-sig", sep=separator, decimal=decimal, lineterminator="\r\n"
    )


def read_table(path: Path) -> pd.DataFrame:
    """The cells of a table that `write_table` wrote, as text, numbers with a decimal point.

    Raises:
        OSError, UnicodeDecodeError, ParserError, EmptyDataError: it can't be read, as of pandas.
    """
    import pandas as pd

    with path.open(encoding="utf-8") as file:
        first = file.readline()
    # No name of a column has a semicolon.
    commas = first.startswith(_MARK) and ";" in first
    table = pd.read_csv(
        path, dtype=str, keep_default_na=False, encoding="utf-8-sig", sep=";" if commas else ","
    )
    if not commas:
        return table
    numbers = [name for name in table if table[name].str.fullmatch(_WITH_COMMA).all()]
    return table.assign(**{str(name): table[name].str.replace(",", ".", regex=False) for name in numbers})


def _decimal_here() -> str:
    """The decimal mark of the machine's language and country."""
    before = locale.setlocale(locale.LC_NUMERIC)
    try:
        locale.setlocale(locale.LC_NUMERIC, "")
        return str(locale.localeconv()["decimal_point"])
    except locale.Error:
        return "."
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
