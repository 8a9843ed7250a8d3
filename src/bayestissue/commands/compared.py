"""What `bayestissue compare` prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from bayestissue.commands.console import plain

_DIGITS = {"elpd": 1, "elpd_difference": 1, "se_difference": 1, "weight": 2}
_HEADINGS = {"elpd_difference": "off the best", "se_difference": "its se"}
# As many as a screen can show.
_PEOPLE = 12


def print_comparison(comparison: pd.DataFrame, posteriors: pd.DataFrame, of_weights: pd.DataFrame) -> None:
    """Print the three tables; see `bayestissue.inference.runs` and `bayestissue.inference.implied`."""
    console = Console(highlight=False)
    told = ["data"] if len(comparison["data"].unique()) > 1 else []
    for scheme, rows in comparison.groupby("scheme", sort=False):
        table = _table(str(scheme), ["run", *told], list(_DIGITS))
        for row in rows.to_dict("records"):
            numbers = [f"{row[k]:.{d}f}" if pd.notna(row[k]) else "" for k, d in _DIGITS.items()]
            table.add_row(plain(row["model"]), *(plain(row[name]) for name in told), *numbers)
        console.print(table)
        for row in rows[rows["warning"] != ""].to_dict("records"):
            console.print(plain(f"  {row['model']}: {row['warning']}"), soft_wrap=True)
    people = posteriors[posteriors["label"] != ""]
    few = people["label"].nunique() <= _PEOPLE
    table = _table("posteriors", ["quantity", "run"], ["median", "5 %", "95 %"])
    for row in (posteriors if few else posteriors[posteriors["label"] == ""]).to_dict("records"):
        table.add_row(plain(_quantity(row)), plain(row["run"]), *_numbers(row))
    console.print(table)
    if len(of_weights):
        table = _table("what the weights imply", ["quantity", "weights"], ["median", "5 %", "95 %"])
        for row in of_weights[of_weights["label"] == ""].to_dict("records"):
            table.add_row(plain(_quantity(row)), plain(f"{row['scheme']}, {row['data']}"), *_numbers(row))
        console.print(table)
    if not few:
        count = people["label"].nunique()
        console.print(f"  K and C of the {count} people: --json prints them, --out writes posteriors.csv")


def _quantity(row: Mapping[Any, Any]) -> str:
    unit = "" if row["unit"] == "1" else f" ({row['unit']})"
    return f"{row['variable']} {row['label']}".strip() + unit


def _numbers(row: Mapping[Any, Any]) -> list[str]:
    return [f"{row[name]:.4g}" for name in ("median", "eti90_low", "eti90_high")]


def _table(title: str, words: list[str], numbers: list[str]) -> Table:
    table = Table(title=plain(title), title_justify="left")
    for name in (*words, *numbers):
        table.add_column(_HEADINGS.get(name, name), justify="right" if name in numbers else "left")
    return table
