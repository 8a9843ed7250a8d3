"""What `bayestissue compare` prints."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd
from rich.console import Console
from rich.table import Table

from bayestissue.commands.console import explained, plain, show
from bayestissue.inference.results.meanings import heading_words
from bayestissue.remedies import codes_in

_DIGITS = {"elpd": 1, "elpd_difference": 1, "se_difference": 1, "weight": 2}
_HEADINGS = {"elpd_difference": "off the best", "se_difference": "its se"}
# As many as a screen can show.
_PEOPLE = 12


def print_comparison(comparison: pd.DataFrame, posteriors: pd.DataFrame, of_weights: pd.DataFrame) -> None:
    """Print the three tables; see `inference.comparing`."""
    console = Console(highlight=False)
    kinds = ["data"] if len(comparison["data"].unique()) > 1 else []
    for scheme, rows in comparison.groupby("scheme", sort=False):
        table = _table(str(scheme), ["run", *kinds], list(_DIGITS))
        for row in rows.to_dict("records"):
            numbers = [f"{row[k]:.{d}f}" if pd.notna(row[k]) else "" for k, d in _DIGITS.items()]
            table.add_row(plain(row["model"]), *(plain(row[name]) for name in kinds), *numbers)
        show(table)
        for row in rows[rows["warning"] != ""].to_dict("records"):
            console.print(plain(f"  {row['model']}: {row['warning']}"), soft_wrap=True)
    explained(codes_in("; ".join(comparison["warning"])))
    people = posteriors[posteriors["label"] != ""]
    few = people["label"].nunique() <= _PEOPLE
    shown = posteriors if few else posteriors[posteriors["label"] == ""]
    _print_intervals(console, "posteriors", shown, shown["run"])
    if len(of_weights):
        shown = of_weights[of_weights["label"] == ""]
        weights = [f"{scheme}, {data}" for scheme, data in zip(shown["scheme"], shown["data"], strict=True)]
        _print_intervals(console, "what the weights imply", shown, weights)
    if not few:
        count = people["label"].nunique()
        console.print(f"  K and C of the {count} people: --json prints them, --out writes posteriors.csv")


def _print_intervals(console: Console, title: str, table: pd.DataFrame, names: Iterable[str]) -> None:
    """Each quantity with what its intervals are of, and under it a line for each of ``names``."""
    console.print(plain(f"{title}: median and 90 % interval", style="italic"))
    rows = table.assign(name=list(names))
    for (variable, level, label, unit), shown in rows.groupby(
        ["variable", "of", "label", "unit"], sort=False
    ):
        heading = heading_words(str(variable), str(level), str(label)) + ("" if unit == "1" else f" ({unit})")
        console.print(plain(heading), soft_wrap=True)
        width = shown["name"].str.len().max()
        for row in shown.to_dict("records"):
            median, low, high = (f"{row[name]:.4g}" for name in ("median", "eti90_low", "eti90_high"))
            console.print(plain(f"  {row['name']:{width}}  {median}, {low} to {high}"), soft_wrap=True)


def _table(title: str, words: list[str], numbers: list[str]) -> Table:
    table = Table(title=plain(title), title_justify="left")
    for name in (*words, *numbers):
        table.add_column(_HEADINGS.get(name, name), justify="right" if name in numbers else "left")
    return table
