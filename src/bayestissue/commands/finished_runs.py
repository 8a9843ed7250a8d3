"""Commands that ask a finished run: `bayestissue ask`, `predict` and `report`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from bayestissue import results, runtime
from bayestissue.commands.options import FinishedFit, Json, Overwrite, Quiet

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.finished import Fit
    from bayestissue.words import Words

_OF_CLAIMS = {
    "posterior": "{value:.3f}",
    "prior": "{value:.3f}",
    "bayes_factor": "{value:.3g}",
    "mcse": "{value:.2g}",
}
_OF_NUMBERS = ("median", "low", "high")
_OF_CHOICES = {
    "posterior": "{value:.3f}",
    "rank_low": "{value:g}",
    "rank_high": "{value:g}",
    "expected_loss": "{value:.3g}",
}
# "from" and "to" stand beside a median.
_HEADINGS = {
    "bayes_factor": "Bayes factor",
    "mcse": "Monte Carlo error",
    "low": "from",
    "high": "to",
    "rank_low": "best rank",
    "rank_high": "worst rank",
    "expected_loss": "expected loss",
}


def ask(
    run: FinishedFit,
    questions: Annotated[list[str], typer.Argument(metavar="QUESTION...")],
    out: Path | None = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Questions to a finished fit: probability by posterior and prior, Bayes factor, Monte Carlo error.

    A comparison gets a probability, all else a median and a 90 % interval. Five examples:

    - `K[side=left over right] > 1.1`: is the left stiffer by a tenth? Levels of any column that a formula
      depends on can stand in the brackets.
    - `K[subject=s1, mass_kg=1.2]`: of this person at this mass. `subject=new` is a person who was not
      measured, `mean(K[subject])` is over people, `K[impact=7]` of one recorded impact.
    - `peak_force[side=left, mass_kg=5, velocity_m_s=2] < 300`: an outcome of an impact of this motion.
      Along gravity `drop_height_cm=30` gives the velocity.
    - `best(side, lowest peak_depth[mass_kg=5])`: which level is best, each with its probability, its rank and
      the expected loss of choosing it. Also `highest`.
    - `critical(velocity_m_s, peak_force[side=left, mass_kg=5] < 300)`: the greatest velocity, or
      `drop_height_cm`, up to which it holds.

    What is left out of the brackets is at the reference: a typical person, the reference mass, the mean of
    other numbers, averaged over sides and other categories. `K[session=after over before, group=treated over
    control]` is a ratio of two ratios, the difference in differences. Any other quantity of summary.csv is
    called by its name: `mass_exponent_K`, `sd_subject_K`, `subject_effect_K[subject=s1]`. Besides: numbers,
    `+ - * / ^ ( )`, abs, exp, log, max, min, mean, `< <= > >=`, between, and, or, not. Odd names stand in
    quotes, those of quantities in backticks.

    Args:
        questions: Such as "K[side=left] / K[side=right] > 1.1" or "mass_exponent_K between -0.1 and 0.1".
        out: Also write questions.csv and report.html to this folder.
    """
    output = _Output(out, overwrite, quiet, as_json)
    _answer("ask", "questions", run, lambda fit: fit.ask(*questions), print_answers, output)


def predict(
    run: FinishedFit,
    at: Annotated[Path, typer.Option(metavar="TABLE.csv")],
    out: Path | None = None,
    draws: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """K, C, depth, force, energy and other outcomes of new impacts, by a finished fit.

    Each row of the table is one new impact, so the intervals hold its scatter too. Numbers that are not given
    are at the reference, which is the reference mass and the mean of others; categories that are not given
    are averaged over; what belongs to a known person follows the person. A person, condition or other level
    that is not given, or was not measured, is a new one of its population. Where the dataset has gravity
    along the motion, drop_height_cm may stand in place of velocity_m_s.

    Args:
        at: A row for each new impact, with any columns of impacts.csv: subject, mass_kg, ...
        out: Also write predictions.csv and report.html to this folder.
        draws: Also write joint draws of all rows to this file, NAME.parquet or NAME.nc (netCDF), from which
            any function of them follows with its interval.
    """
    output = _Output(out, overwrite, quiet, as_json)

    def predicted(fit: Fit) -> pd.DataFrame:
        from bayestissue.commands.console import Stages

        with Stages(quiet=quiet) as say:
            return fit.predict(at, draws=draws, overwrite=overwrite, say=say)

    # A folder that is replaced, or is yet to be, must not hold the file.
    _answer("predict", "predictions", run, predicted, _print_predictions, output, at, draws)
    if draws is not None and not (quiet or as_json):
        from bayestissue.commands.console import echo

        echo(f"wrote {draws}")


def report(
    run: Annotated[Path, typer.Argument(metavar="DIR")],
    quiet: Quiet = False,
) -> None:
    """Write report.html anew from the files of a finished run.

    Args:
        run: Folder of a finished run.
    """
    from bayestissue.commands.console import echo
    from bayestissue.report import write_report

    path = write_report(run)
    if not quiet:
        echo(f"wrote {path}")


class _Output(NamedTuple):
    """Where to write, and how: the options of that name."""

    out: Path | None
    overwrite: bool
    quiet: bool
    as_json: bool


def _answer(
    command: str,
    name: str,
    run: Path,
    table_of: Callable[[Fit], pd.DataFrame],
    show: Callable[[pd.DataFrame, Words], None],
    output: _Output,
    *inputs: Path | None,
) -> None:
    """Make a table of a finished run, print it, and write it into the folder for it if there is one.

    Args:
        command: what the folder says wrote it.
        name: of the table: that of its file, of its page in `bayestissue.report.answers_page`, and its key in
            JSON.
        run: the run's folder.
        table_of: makes the table.
        show: prints it, with the nouns of the run's dataset.
        output: where and how.
        inputs: files besides the run that are read, or written, and must not be overwritten.

    Raises:
        InputError: ``run`` is no finished fit, ``table_of`` finds something wrong, or the folder is not free.
    """
    out, overwrite, quiet, as_json = output
    with results.claim_if(out, overwrite=overwrite, command=command, inputs=(run, *inputs)) as target:
        runtime.configure()
        from bayestissue.commands.console import echo, echo_tables
        from bayestissue.finished import read_run
        from bayestissue.report.wording import names_in, nouns_of

        finished = read_run(run)
        table = table_of(finished)
        if target is not None:
            with target.folder() as folder:
                from bayestissue.report import answers_page

                results.write_table(table, folder / f"{name}.csv")
                page = getattr(answers_page, f"{name}_page")(table, finished.about)
                (folder / "report.html").write_text(page, encoding="utf-8")
        if as_json:
            echo_tables(**{name: table})
        elif not quiet:
            show(table, nouns_of(finished.about, names_in(table)))
            if target is not None:
                echo(f"wrote {target.path / f'{name}.csv'} and {target.path / 'report.html'}")


def print_answers(answers: pd.DataFrame, nouns: Words) -> None:
    """Claims and numbers, each as a table, and under them what is to be said of single ones."""
    import pandas as pd

    from bayestissue.commands.console import explained, line, show, table
    from bayestissue.declarations import filled, general
    from bayestissue.remedies import codes_in
    from bayestissue.report.wording import estimated

    chosen = answers["level"] != ""
    numbers = ~chosen & answers["median"].notna()
    claims = ~chosen & ~numbers

    def cells(row: Mapping[Any, Any], forms: Mapping[str, str]) -> list[str]:
        return [filled(form, value=row[name]) if pd.notna(row[name]) else "" for name, form in forms.items()]

    def numbers_of(row: Mapping[Any, Any]) -> list[str]:
        texts = estimated(*(row[name] for name in _OF_NUMBERS))
        return ["" if text == "nan" else text for text in texts]

    def headings(forms: Iterable[str]) -> list[str]:
        return [_HEADINGS.get(name, name) for name in forms]

    if claims.any():
        rows = [[row["question"], *cells(row, _OF_CLAIMS)] for row in answers[claims].to_dict("records")]
        show(table("probability of each claim", ["claim", *headings(_OF_CLAIMS)], rows))
    if numbers.any():
        rows = [
            [row["question"], *numbers_of(row), row["unit"], general(row["mcse"], 2)]
            for row in answers[numbers].to_dict("records")
        ]
        names = ["quantity", *headings(_OF_NUMBERS), "unit", _HEADINGS["mcse"]]
        show(table("median and 90 % interval", names, rows, words=("quantity", "unit")))
    for question, levels in answers[chosen].groupby("question", sort=False):
        rows = [
            [row["level"], *numbers_of(row), *cells(row, _OF_CHOICES), row["unit"]]
            for row in levels.to_dict("records")
        ]
        names = ["level", *headings(_OF_NUMBERS), "is best", *headings(_OF_CHOICES)[1:], "unit"]
        show(table(str(question), names, rows, words=("level", "unit")))
    for question, of_question in answers.groupby("question", sort=False):
        for who, note in _notes(of_question):
            line(f"  {', '.join([str(question), *who])}: {nouns(note)}")
    line(f"  {_counts(answers)}")
    explained(codes_in("; ".join(answers["note"])))


def _notes(answers: pd.DataFrame) -> list[tuple[list[str], str]]:
    """What is said of one question's answers: of all levels once, then of each what is said of it alone."""
    clauses = [[clause for clause in note.split("; ") if clause] for note in answers["note"]]
    common = [clause for clause in clauses[0] if all(clause in note for note in clauses)]
    single = ("; ".join(clause for clause in note if clause not in common) for note in clauses)
    of_levels = [([level], words) for level, words in zip(answers["level"], single, strict=True)]
    return [(levels, words) for levels, words in [([], "; ".join(common)), *of_levels] if words]


def _counts(table: pd.DataFrame) -> str:
    """How many draws the answers rest on."""
    posterior, prior = table["draws"].max(), table["prior_draws"].max()
    of_prior = f", {int(prior)} of the prior" if prior > 0 else ""
    return f"{int(posterior)} draws of the posterior{of_prior}" if posterior > 0 else ""


def _print_predictions(predictions: pd.DataFrame, nouns: Words) -> None:
    """The median of each quantity with its 90 % interval, and under the table what each row was given."""
    from bayestissue.commands.console import explained, line, show, table
    from bayestissue.remedies import codes_in
    from bayestissue.report.wording import FIRST_PREDICTED, covariate_words, predicted_words

    headings = [f"{heading.removeprefix('time ')} ({unit})" for heading, unit, _ in FIRST_PREDICTED.values()]
    rows = predictions.to_dict("records")
    cells = (
        [str(number), *("\n".join(predicted_words(row, name)) for name in FIRST_PREDICTED)]
        for number, row in enumerate(rows, start=1)
    )
    show(table(nouns("a new impact: median and 90 % interval"), ["row", *headings], cells))
    for number, row in enumerate(rows, start=1):
        words = [covariate_words(row)]
        words += [f"new: {row['new']}"] * bool(row["new"]) + [nouns(row["note"])] * bool(row["note"])
        line(f"  row {number}: {'; '.join(words)}")
    explained(codes_in("; ".join(predictions["note"])))
