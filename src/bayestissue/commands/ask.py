"""`bayestissue ask`: questions to a finished fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayestissue.commands.answers import answer
from bayestissue.commands.options import Excel, FinishedFit, Json, Overwrite, Quiet

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.results import Excel

_DIGITS = {"posterior": "{:.3f}", "prior": "{:.3f}", "bayes_factor": "{:.3g}", "mcse": "{:.2g}"}
_HEADINGS = {"bayes_factor": "Bayes factor", "mcse": "Monte Carlo error"}


def run(
    run: FinishedFit,
    questions: Annotated[
        list[str],
        typer.Argument(
            metavar="QUESTION...",
            help='Such as "K[side=left] / K[side=right] > 1.1" or "mass_exponent_K between -0.1 and 0.1".',
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write questions.csv and report.html to this folder.")
    ] = None,
    excel: Excel = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Questions to a finished fit: probability by posterior and prior, Bayes factor, Monte Carlo error.

    K alone is that of a typical person at the reference mass, the mean of other numbers and the first
    category. K[subject=s01, mass_kg=1.2] has these instead; all impacts' columns of the formula can be named,
    and what belongs to a person, such as sex, follows the person. K[subject=new] is a new person's,
    mean(K[subject, sex=f]) is over people, K[impact=7] is of one recorded impact. Any other quantity of
    summary.csv is called by its name: mass_exponent_K, sd_subject_K, K_new, subject_effect_K[subject=s01].
    Besides: numbers, + - * / ^ ( ), abs, exp, log, max, min, mean, < <= > >=, between, and, or, not. Odd
    names stand in quotes, those of quantities in backticks. Without a comparison the answer is a median and
    a 90 % interval.
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

    from bayestissue.commands.console import explained, plain, show
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
        show(shown)
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
        show(shown)
    for row in table[table["note"] != ""].to_dict("records"):
        console.print(plain(f"  {row['question']}: {row['note']}"), soft_wrap=True)
    console.print(plain(f"  {_counts(table)}"), soft_wrap=True)
    explained(codes_in("; ".join(table["note"])))


def _counts(table: pd.DataFrame) -> str:
    """How many draws the answers rest on."""
    posterior, prior = table["draws"].max(), table["prior_draws"].max()
    of_prior = f", {int(prior)} of the prior" if prior > 0 else ""
    return f"{int(posterior)} draws of the posterior{of_prior}" if posterior > 0 else ""
