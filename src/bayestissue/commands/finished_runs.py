"""Commands of finished fits: `bayestissue ask`, `predict`, `compare`, `certify`, `export` and `report`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayestissue.base.errors import more
from bayestissue.base.remedies import codes_in
from bayestissue.base.result import Made
from bayestissue.base.words import Words
from bayestissue.commands.delivery import Call, FinishedFit, Quiet, Seed, delivers
from bayestissue.reports.paper import WIDTH_MM
from bayestissue.studies.certificate import FEWEST_REFITS, MOST_REFITS, REFITS

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.commands.console import Shown
    from bayestissue.studies.certificate.certificate import Certificate
    from bayestissue.studies.comparing import Comparison
    from bayestissue.studies.finished import Fit


def _made(fit: Fit, name: str, table: pd.DataFrame, words: Callable[..., Iterator[Shown]]) -> Made:
    """A table that a finished fit was asked for; ``name`` is that of its file and its page."""
    from bayestissue.reports.pages import answers_page
    from bayestissue.reports.pages.wording import names_in, nouns_of

    page = getattr(answers_page, f"{name}_page")
    return Made(
        tables={name: table},
        html=lambda _: page(table, fit.about),
        files=(f"{name}.csv", "report.html"),
        words=words(table, nouns_of(fit.about, names_in(table))),
    )


@delivers("as_json", out=None, inputs=("run",))
def ask(
    run: FinishedFit,
    questions: Annotated[list[str], typer.Argument(metavar="QUESTION...")],
    *,
    call: Call,
) -> Made:
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
    from bayestissue.studies.finished import read_run

    fit = read_run(run)
    return _made(fit, "questions", fit.ask(*questions), of_answers)


# A folder that is replaced, or is yet to be, must not hold the file of draws.
@delivers("as_json", out=None, inputs=("run", "at", "draws"))
def predict(
    run: FinishedFit,
    at: Annotated[Path, typer.Option(metavar="TABLE.csv")],
    draws: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    *,
    call: Call,
) -> Made:
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
    from bayestissue.studies.finished import read_run

    fit = read_run(run)
    table = fit.predict(at, draws=draws, overwrite=call.overwrite, say=call.say)
    result = _made(fit, "predictions", table, of_predictions)
    return result if draws is None else replace(result, words=[*result.words, f"wrote {draws}"])


def report(run: Annotated[Path, typer.Argument(metavar="DIR")], quiet: Quiet = False) -> None:
    """Write report.html anew from the files of a finished run.

    Args:
        run: Folder of a finished run.
    """
    from bayestissue.commands.console import echo
    from bayestissue.reports.pages import write_report

    path = write_report(run)
    if not quiet:
        echo(f"wrote {path}")


@delivers(inputs=("run", "certificate"))
def export(
    run: FinishedFit,
    certificate: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    width: Annotated[float, typer.Option(metavar="MM", min=40, max=400)] = WIDTH_MM,
    *,
    call: Call,
) -> Made:
    """A finished fit for a paper: methods and results as text, all tables in one workbook, figures.

    methods.md and methods.docx hold paragraphs with this run's numbers, settings, versions and references;
    read them before you use them, and say what the program can't know: who was measured, where and why.
    tables.xlsx has every table of the run, an impact a row, and people_wide, a row a person and a column a
    side and condition, as SPSS, JASP and Excel want it; its sheet columns says what each means. figures/ has
    each figure as SVG, PDF and PNG, and the rows that it is drawn from as CSV.

    checklists.md has the checklists BARG (Bayesian analyses) and GRRAS (reliability), answered where the run
    knows the answer; the rest are questions to you.

    Args:
        certificate: Folder of `bayestissue certify` of this run, whose verdict the checklists then state.
        width: Of a figure in print; a journal's column is about 85 mm wide, its page 170.
    """
    from bayestissue.studies.finished import read_run

    return read_run(run).paper(certificate=certificate, width_mm=width)


def _of_certificate(certificate: Certificate) -> Iterator[Shown]:
    nouns, items = Words(certificate.about["words"]), certificate.checklists
    yield nouns(certificate.about["verdict"]["prior"])
    answered = int(items["answered"].sum())
    yield f"checklists: {answered} of {len(items)} items answered; the others are questions"


def _beside(arguments: Mapping[str, Any]) -> Path:
    """Where a certificate goes: beside the run."""
    run: Path = arguments["run"].resolve()
    return run.with_name(f"{run.name}-certificate")


@delivers(
    out=_beside,
    inputs=("run", "dataset"),
    verdict=lambda certificate: [Words(certificate.about["words"])(certificate.words)],
    shown=_of_certificate,
)
def certify(
    run: FinishedFit,
    refits: Annotated[int, typer.Option(min=FEWEST_REFITS, max=MOST_REFITS)] = REFITS,
    dataset: Annotated[Path | None, typer.Option(metavar="DATASET")] = None,
    seed: Seed = 0,
    *,
    call: Call,
) -> Certificate:
    """Certify a finished fit: draw its study anew from its own posterior, fit it each time, and compare.

    Of a fit that samples its posterior, nine in ten 90 % intervals of such refits hold the truth that was
    drawn, and its ranks are uniform (posterior simulation-based calibration). The certificate also says which
    results the priors move, and has the checklists BARG and GRRAS, answered where the run knows the answer.
    It tests the program on this study, not the model: for that see the report's section on residuals.

    The example takes about five minutes. An interrupted certificate goes on where it stopped when the same
    command is given again. Exit status 3: not calibrated, or the fit's own diagnostics failed.

    Args:
        out: Folder for the certificate; RUN-certificate beside the run unless given.
        refits: Studies that are drawn and fitted. Twenty show gross faults, a hundred finer ones.
        dataset: The recordings that were fitted, where they are no longer where the run says.
    """
    from bayestissue.studies.certificate.certificate import CertificateJob

    job = CertificateJob.of_run(run, dataset, refits=refits, seed=seed)
    return job.certificate(call.say, call.parts(job.fingerprint()))


def _of_comparison(compared: Comparison) -> Iterator[Shown]:
    """The two tables, see `bayestissue.studies.comparing`, and answers to what was asked."""
    from bayestissue.commands.console import SCREEN, Grid
    from bayestissue.inference.model_comparison import OF_OUTCOMES
    from bayestissue.reports.pages.page_tables import shown

    comparison, posteriors = compared.comparison, compared.posteriors
    same = ["data"] if len(comparison["data"].unique()) == 1 else []
    for scheme, rows in comparison.groupby("scheme", sort=False):
        yield Grid(str(scheme), shown("comparison", rows.drop(columns=same), "runs"))
        for row in rows[rows["warning"] != ""].to_dict("records"):
            yield f"  {row['model']}: {row['warning']}"
    yield more(codes_in(*comparison["warning"]))
    together = posteriors["label"] == ""
    count = posteriors.loc[~together, "label"].nunique()
    few = count <= SCREEN.people
    yield from _of_posteriors(posteriors[together | (few & ~posteriors["variable"].isin(OF_OUTCOMES))])
    if count:
        what = "outcomes" if few else "K, C and outcomes"
        yield f"  {what} of the {count} people: --json prints them, --out writes posteriors.csv"
    if compared.asked:
        yield from _of_compared_answers(compared.answers, compared.asked)


@delivers("as_json", out=None, inputs=("runs",), shown=_of_comparison)
def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="DIR")],
    ask: Annotated[list[str] | None, typer.Option(metavar="QUESTION")] = None,
    *,
    call: Call,
) -> Comparison:
    """Which finished fit predicts best what it has not seen, and whether the fits agree on K and C.

    Args:
        runs: Folders of two or more finished fits of one dataset.
        ask: Answered by each run, such as "peak_force[mass_kg=5, velocity_m_s=2] < 300"; may be given
            several times.
        out: Also write the tables and a page with figures.
    """
    from bayestissue.studies import comparing

    return comparing.compare(*runs, ask=ask or ())


def of_answers(answers: pd.DataFrame, nouns: Words) -> Iterator[Shown]:
    """Claims and numbers, each as a table, and under them what is to be said of single ones."""
    from bayestissue.commands.console import Grid
    from bayestissue.reports.pages.page_tables import shown

    chosen = answers["level"] != ""
    numbers = ~chosen & answers["median"].notna()
    claims = ~chosen & ~numbers
    if claims.any():
        yield Grid("probability of each claim", shown("questions", answers[claims], "claims"))
    if numbers.any():
        yield Grid("median and 90 % interval", shown("questions", answers[numbers], "numbers"))
    for question, levels in answers[chosen].groupby("question", sort=False):
        yield Grid(str(question), shown("questions", levels, "choices"))
    for question, of_question in answers.groupby("question", sort=False):
        for who, note in _notes(of_question):
            yield f"  {', '.join([str(question), *who])}: {nouns(note)}"
    yield f"  {_counts(answers)}"
    yield more(codes_in(*answers["note"]))


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


def of_predictions(predictions: pd.DataFrame, nouns: Words) -> Iterator[Shown]:
    """The median of each quantity with its 90 % interval, and under the table what each row was given."""
    from bayestissue.commands.console import Grid
    from bayestissue.reports.pages.page_tables import Field, table_of
    from bayestissue.reports.pages.wording import FIRST_PREDICTED, covariate_words, predicted_words

    def quantity(name: str) -> Field:
        heading, unit, _ = FIRST_PREDICTED[name]
        title = f"{heading.removeprefix('time ')} ({unit})"
        return Field(title, lambda row: "\n".join(predicted_words(row[1], name)), "number")

    rows = list(enumerate(predictions.to_dict("records"), start=1))
    table = table_of(rows, Field("row", lambda row: str(row[0])), *map(quantity, FIRST_PREDICTED))
    yield Grid(nouns("a new impact: median and 90 % interval"), table)
    for number, row in rows:
        words = [covariate_words(row)]
        words += [f"new: {row['new']}"] * bool(row["new"]) + [nouns(row["note"])] * bool(row["note"])
        yield f"  row {number}: {'; '.join(words)}"
    yield more(codes_in(*predictions["note"]))


def _of_compared_answers(answers: pd.DataFrame, questions: Collection[str]) -> Iterator[Shown]:
    """What was asked on the command line: a line of each run."""
    from bayestissue.reports.pages.comparison import answer_words

    # A choice has an answer for each level.
    shown = answers[answers["question"].str.startswith(tuple(questions))]
    for question, rows in shown.groupby("question", sort=False):
        yield str(question)
        yield from _by_run(rows, answer_words)


def _of_posteriors(posteriors: pd.DataFrame) -> Iterator[Shown]:
    """Each quantity with what its intervals are of, and under it a line for each run."""
    from bayestissue.commands.console import Heading
    from bayestissue.inference.results.meanings import heading_words
    from bayestissue.reports.pages.wording import estimated

    yield Heading("posteriors: median and 90 % interval")
    for (variable, level, label, unit), shown in posteriors.groupby(
        ["variable", "of", "label", "unit"], sort=False
    ):
        yield heading_words(str(variable), str(level), str(label)) + ("" if unit == "1" else f" ({unit})")
        yield from _by_run(
            shown,
            lambda row: "{}, {} to {}".format(*estimated(row["median"], row["eti90_low"], row["eti90_high"])),
        )


def _by_run(rows: pd.DataFrame, words: Callable[[Mapping[Any, Any]], str]) -> Iterator[str]:
    """A line for each run."""
    width = rows["run"].str.len().max()
    return (f"  {row['run']:{width}}  {words(row)}" for row in rows.to_dict("records"))
