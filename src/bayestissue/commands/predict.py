"""`bayestissue predict`: K, C and the peaks of new impacts by a finished fit."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayestissue.commands.answers import answer
from bayestissue.commands.options import Excel, FinishedFit, Json, Overwrite, Quiet

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.results import Excel


def run(
    run: FinishedFit,
    at: Annotated[
        Path,
        typer.Option(
            "--at",
            metavar="TABLE.csv",
            help="A row for each new impact, with any columns of impacts.csv: subject, mass_kg, ...",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write predictions.csv and report.html to this folder.")
    ] = None,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """K, C, greatest depth and force, and time to peak of new impacts, by a finished fit.

    Each row of the table is one new impact, so the intervals hold its scatter too. Numbers and categories
    that are not given are at the reference: the reference mass, mean numbers, the first recorded category;
    what belongs to a known person follows the person. A person, condition or other level that is not given,
    or was not measured, is a new one of its population.
    """
    answer(
        run,
        lambda finished: finished.predict(at),
        _print,
        command="predict",
        name="predictions",
        inputs=(run, at),
        out=out,
        excel=excel,
        overwrite=overwrite,
        quiet=quiet,
        as_json=as_json,
    )


def _print(table: pd.DataFrame) -> None:
    """The median of each quantity with its 90 % interval, and under the table what each row was given."""
    from rich.console import Console
    from rich.table import Table

    from bayestissue.commands.console import explained, plain, show
    from bayestissue.remedies import codes_in
    from bayestissue.report.wording import PREDICTED, covariate_words

    console = Console(highlight=False)
    shown = Table("row", title="a new impact: median and 90 % interval", title_justify="left")
    for heading, unit, _ in PREDICTED.values():
        shown.add_column(f"{heading.removeprefix('time ')} ({unit})", justify="right")
    rows = table.to_dict("records")
    for number, row in enumerate(rows, start=1):
        shown.add_row(f"{number}", *(_cell(row, name) for name in PREDICTED))
    show(shown)
    for number, row in enumerate(rows, start=1):
        said = [covariate_words(row)]
        said += [f"new: {row['new']}"] * bool(row["new"]) + [row["note"]] * bool(row["note"])
        console.print(plain(f"  row {number}: {'; '.join(said)}"), soft_wrap=True)
    explained(codes_in("; ".join(table["note"])))


def _cell(row: dict[Hashable, Any], name: str) -> str:
    import math

    from bayestissue.report.wording import PREDICTED, significant

    if math.isnan(row[name]):
        return ""
    factor = PREDICTED[name][2]
    median, low, high = (significant(factor * row[f"{name}{end}"]) for end in ("", "_low", "_high"))
    return f"{median}\n{low} to {high}"
