"""Commands of a dataset: `bayestissue simulate`, `check`, `estimate` and `fit`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bayestissue.base import runtime
from bayestissue.base.errors import Coded, Problem, codes_of, more
from bayestissue.base.outline import counted
from bayestissue.base.remedies import codes_in, entries
from bayestissue.base.result import Made, Result, after_results
from bayestissue.base.words import Words
from bayestissue.commands.delivery import (
    Call,
    DatasetFolder,
    FormulaOfC,
    FormulaOfK,
    Model,
    OtherSeed,
    Seed,
    delivers,
)
from bayestissue.commands.finished_runs import certify as certify_run
from bayestissue.commands.finished_runs import of_answers

if TYPE_CHECKING:
    from bayestissue.commands.console import Shown
    from bayestissue.model.hierarchy.specification import ModelSpecification
    from bayestissue.model.hierarchy.trace_data import Prepared
    from bayestissue.recordings.dataset import Dataset
    from bayestissue.studies.checking import Check
    from bayestissue.studies.estimates import Estimates
    from bayestissue.studies.finished import Fit

# Warnings of a dataset by which people may be counted wrongly.
_OF_PEOPLE = ("one-person-or-two", "two-spellings")


def _of_check(checked: Check) -> Iterator[Shown]:
    from bayestissue.commands.console import Grid, Heading
    from bayestissue.reports.pages.page_tables import table_of_cells
    from bayestissue.reports.pages.recordings_pages import kinds

    data, nouns = checked.dataset, Words(checked.dataset.words)
    rows = (*checked.summary, *(("note", words) for words in checked.notes))
    title = f"{data.name}: {checked.verdict}"
    yield Grid(title, table_of_cells([(nouns(name), nouns(words)) for name, words in rows], "", ""))
    for heading, problems in (("Left out", data.left_out), ("Warnings", checked.warnings)):
        if problems:
            yield Heading(f"{heading}:")
        for first, *others in kinds(problems):
            same = f" The same in {_names(others)}." if others else ""
            yield f"  {first}{same} [{first.code}]"
    codes = [problem.code for problem in (*data.left_out, *checked.warnings)]
    yield more([*codes, *codes_in(*checked.notes)])


def _names(problems: list[Problem]) -> str:
    """The impacts, up to ten by name."""
    from bayestissue.commands.console import SCREEN

    names = list(dict.fromkeys(problem.impact for problem in problems if problem.impact))
    named, further = names[: SCREEN.named], len(names) - SCREEN.named
    others = f" and {further} more impacts" if further > 0 else ""
    return f"{', '.join(named)}{others}" if names else f"{len(problems)} more places"


@delivers("skip_bad", "as_json", out=None, inputs=("dataset",), shown=_of_check)
def check(dataset: DatasetFolder, *, call: Call) -> Check:
    """Say what is wrong with a dataset: file, row, column, value, what was expected, how to mend it.

    Args:
        out: Also write quality figures and a page with one panel per impact.
    """
    from bayestissue.recordings.dataset import read_dataset
    from bayestissue.studies import checking

    return checking.check(read_dataset(dataset, skip_bad=call.skip_bad))


def _of_estimates(estimates: Estimates) -> Iterator[Shown]:
    from bayestissue.commands.console import Grid
    from bayestissue.inference.points.notes import people_alone, said_once
    from bayestissue.reports.pages.page_tables import table_of_cells
    from bayestissue.reports.pages.wording import estimated

    left_out = estimates.dataset.left_out
    flagged = int((estimates["flags"] != "").sum())
    rows, people = [], people_alone(estimates)
    for name, words in (("K_N_per_m", "K (N/m)"), ("C_N_s_per_m", "C (N s/m)"), ("zeta", "zeta")):
        low, median, high = people[name].quantile([0.05, 0.5, 0.95])
        rows.append((words, *estimated(median, low, high)))
    which = "these impacts" if len(people) == len(estimates) else "people's impacts"
    title = f"{estimates.dataset.name}: {counted(len(estimates), 'impact')}, {flagged} flagged"
    numbers = ("median", "5 % below", "95 % below")
    yield Grid(title, table_of_cells(rows, which, *numbers, number=numbers))
    if estimates["K_N_per_m"].isna().all():
        remedies = (entries()[code] for code in codes_in(*estimates["flags"]))
        yield " ".join(["No impact has K.", *(f"{entry.title}: {entry.remedy}" for entry in remedies)])
    yield from said_once(estimates["notes"])
    if left_out:
        count = len({problem.impact for problem in left_out})
        yield f"{counted(count, 'impact')} left out: see left_out.csv"
    texts = "; ".join([*estimates["flags"], *estimates["notes"]])
    yield more([*codes_in(texts), *(problem.code for problem in left_out)])


@delivers("scheduler", "skip_bad", "as_json", inputs=("dataset", "model"), shown=_of_estimates)
def estimate(
    dataset: DatasetFolder,
    method: Literal["impact", "dds"] = "impact",
    model: Model = None,
    *,
    call: Call,
) -> Estimates:
    """K and C of every impact by itself, with 90 % intervals; --method dds has the thesis's own points.

    Args:
        method: impact: the posterior of each impact given its own trace and its measuring chain. dds: the
            thesis's conditional fit about the sample mean, without intervals.
        model: A model, by name or as a file, as in fit; its [signal] table says where contact is in the
            recordings, and which part of them is used.
    """
    from bayestissue.base.resources import model_file
    from bayestissue.inference.execution.workers import on_cluster
    from bayestissue.recordings.dataset import read_dataset
    from bayestissue.recordings.signal import SignalOptions, read_signal_options
    from bayestissue.studies import estimates as estimates_page

    file = None if model is None else model_file(model, lambda content: "signal" in content)
    options = read_signal_options(file) if file else SignalOptions()
    data = read_dataset(dataset, skip_bad=call.skip_bad)
    call.patience_s = 30.0
    with on_cluster(call.scheduler):
        estimates = estimates_page.estimate(data, method=method, options=options, say=call.say)
    estimates.file = file
    return estimates


def _of_fit(fit: Fit) -> Iterator[Shown]:
    from bayestissue.inference.checking.findings import headline, warned_codes

    assert fit.dataset is not None and fit.prepared is not None  # noqa: S101, PT018 - just fitted
    nouns = Words(fit.about["words"])
    if fit.specification.questions:
        yield from of_answers(fit.questions, nouns)
    yield from nouns(f"{headline(fit.diagnostics)}\n{fit.verdict}").splitlines()
    yield more([*codes_of(what_is_untold(fit.dataset, fit.prepared)), *warned_codes(fit.diagnostics)])


@delivers("scheduler", "skip_bad", inputs=("dataset", "model"), shown=_of_fit)
def fit(
    dataset: DatasetFolder,
    model: Model = None,
    K: FormulaOfK = None,
    C: FormulaOfC = None,
    ask: Annotated[list[str] | None, typer.Option(metavar="QUESTION")] = None,
    continue_from: Annotated[Path | None, typer.Option("--continue", metavar="RUN")] = None,
    certify: bool = False,
    seed: Seed = 0,
    *,
    call: Call,
) -> Fit:
    """The posterior of K and C from the traces: of every impact, person and condition, and of the exponents.

    An interrupted fit goes on where it stopped when the same command is given again. A finished one goes on
    with --continue: for more draws, or where its chains did not agree yet.

    Args:
        K: What log K depends on, such as "log(mass_kg) + side + (1|subject)"; as the model has it unless
            given.
        ask: Answered at the end and on the page, such as "K[side=left] / K[side=right] > 1.1"; may be given
            again.
        continue_from: Folder of a finished fit of the same recordings and model, whose chains go on where
            they ended; may be --out itself, with --overwrite.
        certify: Then certify the fit, as `bayestissue certify` does, in OUT-certificate.
    """
    from bayestissue.inference.execution.workers import on_cluster
    from bayestissue.recordings.dataset import read_dataset
    from bayestissue.studies.finished import CHAIN
    from bayestissue.studies.fitting import FitRequest, fit_job

    data = read_dataset(dataset, skip_bad=call.skip_bad)

    def resolved(specification: ModelSpecification) -> None:
        if model is None:
            call.echo(
                f"model {specification.name}, that of a recorded {data.quantity}; --model takes another"
            )

    request = FitRequest(model, K, C, ask or [], continue_from)
    job = fit_job(data, request, seed, skip_short=call.skip_bad, resolved=resolved)
    nouns = Words(data.words)
    for words in what_is_untold(data, job.prepared):
        call.echo(nouns(words))
    # What must be the same for a checkpoint to be one of this job.
    content = [data.input_hash, job.specification.model_dump_json(), seed, runtime.versions()]
    if continue_from is not None:
        content.append(runtime.content_hash([continue_from / CHAIN]))
    if certify:
        call.then = partial(_certified, seed=seed, call=call)
    parts = call.parts(hashlib.sha256(json.dumps(content).encode()).hexdigest())
    with on_cluster(call.scheduler):
        return job.fit(call.say, checkpoints=parts)


def _certified(run: Path, seed: int, call: Call) -> bool:
    """Whether the certificate of a run, which is made now, passed."""
    again = f"`bayestissue certify {run}` goes on with it"
    with after_results(run, again, failed="they could not be certified", code="certificate-not-made"):
        try:
            certify_run(run=run, seed=seed, overwrite=call.overwrite, quiet=call.quiet)
        except typer.Exit:
            return False
    return True


def what_is_untold(dataset: Dataset, prepared: Prepared) -> list[str]:
    """What these data can't tell, to be said before the work begins."""
    from bayestissue.inference.results.meanings import ONE_IMPACT, few_valued_words
    from bayestissue.model.hierarchy.columns import untried, untried_words
    from bayestissue.model.hierarchy.formulas.formula import left_out_words

    # Who is who decides how much the people tell.
    words = [
        *[Coded(str(problem), problem.code) for problem in dataset.warnings if problem.code in _OF_PEOPLE],
        left_out_words(prepared.design.terms_left_out()),
        *untried_words(untried(prepared.design.recorded)),
        *few_valued_words(prepared.design.few_valued()),
        *[ONE_IMPACT] * (len(prepared.impacts) == 1),
        *[f"contact is taken to be {prepared.signal.phase.words}"] * prepared.signal.phase.known,
    ]
    return [said for said in words if said]


@delivers(inputs=("specification",))
def simulate(
    specification: Annotated[Path, typer.Argument(metavar="SPEC.toml")],
    seed: OtherSeed = None,
    *,
    call: Call,
) -> Result:
    """Make a dataset whose truth is known: a design, a tissue, a measuring chain, and truth.csv beside it.

    Args:
        specification: Design, tissue, measuring chain and seed.
        seed: Instead of the one in SPEC.toml.
    """
    from bayestissue.studies import simulation

    stated = simulation.read_simulation(specification)
    if seed is not None:
        stated = stated.model_copy(update={"seed": seed})
    campaign = simulation.simulate(stated)
    lines = specification.read_text(encoding="utf-8-sig").splitlines()
    unseeded = [line for line in lines if line.split("=")[0].strip() != "seed"]

    def write(folder: Path) -> None:
        simulation.write_campaign(folder, campaign, stated)
        text = "\n".join([f"seed = {stated.seed}", *unseeded, ""])
        (folder / "truth.toml").write_text(text, encoding="utf-8")

    impacts, samples = counted(len(campaign.impacts), "impact"), campaign.traces.value.size
    return Made(further=write, said=f"wrote {{folder}}: {impacts}, {samples} samples, seed {stated.seed}")
