"""`bayestissue ask`: questions to a finished fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayestissue.commands.answers import answer

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.results import Excel

_DIGITS = {"posterior": "{:.3f}", "prior": "{:.3f}", "bayes_factor": "{:.3g}", "mcse": "{:.2g}"}
_HEADINGS = {"bayes_factor": "Bayes factor", "mcse": "Monte Carlo error"}


def run(
    run: Path,
    questions: list[str],
    *,
    out: Path | None,
    excel: Excel | None = None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Answer questions, print them and, with ``out``, write ``questions.csv`` and a page.

    Raises:
        InputError: ``run`` is no finished fit, questions can't be read or answered (all of them are told), or
            ``out`` is not free.
    """
    answer(
        run,
        lambda finished: finished.ask(*questions),
        print_answers,
        command="ask",
        name="questions",
        inputs=(run,),
        out=out,
        excel=excel,
        overwrite=overwrite,
        quiet=quiet,
        as_json=as_json,
    )


def print_answers(table: pd.DataFrame) -> None:
    """Claims and numbers, each as a table, and under them what is to be said of single ones."""
    import pandas as pd
    from rich.console import Console
    from rich.table import Column, Table

    from bayestissue.commands.console import explained, plain
    from bayestissue.remedies import codes_in

    console = Console(highlight=False)
    numbers = table["median"].notna()
    of_claims = table[~numbers]
    if len(of_claims):
        shown = Table(
            Column("claim", overflow="fold"), title="probability of each claim", title_justify="left"
        )
        for name in _DIGITS:
            shown.add_column(_HEADINGS.get(name, name), justify="right")
        for row in of_claims.to_dict("records"):
            cells = [form.format(row[k]) if pd.notna(row[k]) else "" for k, form in _DIGITS.items()]
            shown.add_row(plain(row["question"]), *cells)
        console.print(shown)
    if numbers.any():
        shown = Table(
            Column("quantity", overflow="fold"), title="median and 90 % interval", title_justify="left"
        )
        for heading in ("median", "from", "to"):
            shown.add_column(heading, justify="right")
        shown.add_column("unit")
        shown.add_column("Monte Carlo error", justify="right")
        for row in table[numbers].to_dict("records"):
            cells = [f"{row[name]:.4g}" for name in ("median", "low", "high")]
            shown.add_row(plain(row["question"]), *cells, row["unit"], f"{row['mcse']:.2g}")
        console.print(shown)
    for row in table[table["note"] != ""].to_dict("records"):
        console.print(plain(f"  {row['question']}: {row['note']}"), soft_wrap=True)
    console.print(plain(f"  {_counts(table)}"), soft_wrap=True)
    explained(codes_in("; ".join(table["note"])))


def _counts(table: pd.DataFrame) -> str:
    """How many draws the answers rest on."""
    posterior, prior = table["draws"].max(), table["prior_draws"].max()
    besides = f", {int(prior)} of the prior" if prior > 0 else ""
    return f"{int(posterior)} draws of the posterior{besides}" if posterior > 0 else ""
