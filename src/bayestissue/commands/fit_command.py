"""``fit``: the posterior of K and C from recorded traces, and its report."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayestissue.base import runtime
from bayestissue.base.errors import Coded, codes_of, more
from bayestissue.base.result import after_results
from bayestissue.base.words import Words
from bayestissue.commands.delivery import Call, DatasetFolder, FormulaOfC, Model, Seed, delivers
from bayestissue.commands.finished_runs import certify as certify_run
from bayestissue.commands.finished_runs import of_answers

if TYPE_CHECKING:
    from bayestissue.commands.console import Shown
    from bayestissue.model.hierarchy.specification import ModelSpecification
    from bayestissue.model.hierarchy.trace_data import Prepared
    from bayestissue.recordings.dataset import Dataset
    from bayestissue.studies.finished import Fit

# Warnings of a dataset by which people may be counted wrongly.
_OF_PEOPLE = ("one-person-or-two", "two-spellings")


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
    K: Annotated[str | None, typer.Option("--K", metavar="FORMULA")] = None,
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
