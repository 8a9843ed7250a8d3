"""``fit``: the posterior of K and C from recorded traces, and its report."""

from __future__ import annotations

import hashlib
import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayestissue import results, runtime
from bayestissue.commands.options import (
    FAILED_DIAGNOSTICS,
    DatasetFolder,
    FormulaOfC,
    Model,
    Out,
    Overwrite,
    Quiet,
    Scheduler,
    Seed,
    SkipBad,
)
from bayestissue.errors import Coded
from bayestissue.words import Words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayestissue.errors import Problem
    from bayestissue.hierarchy.specification import ModelSpecification
    from bayestissue.hierarchy.trace_data import Prepared
    from bayestissue.remedies import Code

# Warnings of a dataset by which people may be counted wrongly.
_OF_PEOPLE = ("one-person-or-two", "two-spellings")


def run(
    dataset: DatasetFolder,
    out: Out,
    model: Model = None,
    K: Annotated[str | None, typer.Option("--K", metavar="FORMULA")] = None,
    C: FormulaOfC = None,
    ask: Annotated[list[str] | None, typer.Option(metavar="QUESTION")] = None,
    continue_from: Annotated[Path | None, typer.Option("--continue", metavar="RUN")] = None,
    certify: bool = False,
    scheduler: Scheduler = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
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
    runtime.configure(one_core=True)
    with results.claim(out, overwrite=overwrite, command="fit", inputs=(dataset, model)) as target:
        from bayestissue.commands.console import Stages, echo, explained
        from bayestissue.commands.finished_runs import print_answers
        from bayestissue.dataset import read_dataset
        from bayestissue.finished import CHAIN, page_html, write_run
        from bayestissue.fitting import fit_job
        from bayestissue.inference.execution.workers import on_cluster
        from bayestissue.inference.samplers.diagnostics import headline, warned_codes
        from bayestissue.report import draw_page

        data = read_dataset(dataset, skip_bad=skip_bad)

        def resolved(specification: ModelSpecification) -> None:
            if model is None and not quiet:
                echo(f"model {specification.name}, that of a recorded {data.quantity}; --model takes another")

        asked: dict[str, Any] = {"K": K, "C": C, "ask": ask or [], "continue_from": continue_from}
        job = fit_job(data, model, seed, **asked, skip_short=skip_bad, resolved=resolved)
        nouns = Words(data.words)
        codes = [] if quiet else _say_what_is_told(job.prepared, nouns, data.warnings)
        # What must be the same for a checkpoint to be one of this job.
        content = [data.input_hash, job.specification.model_dump_json(), seed, runtime.versions()]
        if continue_from is not None:
            content.append(runtime.content_hash([continue_from / CHAIN]))
        key = hashlib.sha256(json.dumps(content).encode()).hexdigest()
        with Stages(quiet=quiet) as say:
            with on_cluster(scheduler), target.unfinished(key) as finished:
                fit = job.fit(say, checkpoints=finished)
                with target.folder() as folder:
                    write_run(fit, folder, say)
            say("writing the report", 0, 1)
            draw_page(target.path, partial(page_html, fit))
        if not quiet:
            if job.specification.questions:
                print_answers(fit.questions, nouns)
            echo(nouns(f"{headline(fit.diagnostics)}\n{fit.verdict}"))
            explained([*codes, *warned_codes(fit.diagnostics)])
            echo(f"wrote {target.path / 'report.html'}")
    passed = fit.diagnostics["passed"]
    if certify:
        from bayestissue.commands.certify import certified
        from bayestissue.report.run_folder import after_results

        again = f"`bayestissue certify {target.path}` goes on with it"
        failed = "they could not be certified"
        with after_results(target.path, again, failed=failed, code="certificate-not-made"):
            passed &= certified(target.path, seed=seed, overwrite=overwrite, quiet=quiet)
    if not passed:
        raise typer.Exit(FAILED_DIAGNOSTICS)


def _say_what_is_told(prepared: Prepared, nouns: Words, warnings: Sequence[Problem]) -> list[Code]:
    """What these data can't tell, before the work begins; the codes of what was said."""
    from bayestissue.commands.console import echo
    from bayestissue.errors import codes_of
    from bayestissue.hierarchy.formulas.formula import left_out_words
    from bayestissue.hierarchy.untried import untried, untried_words
    from bayestissue.inference.results.meanings import ONE_IMPACT, few_valued_words

    # Who is who decides how much the people tell.
    words = [
        *[Coded(str(problem), problem.code) for problem in warnings if problem.code in _OF_PEOPLE],
        left_out_words(prepared.design.terms_left_out()),
        *untried_words(untried(prepared.design.recorded)),
        *few_valued_words(prepared.design.few_valued()),
        *[ONE_IMPACT] * (len(prepared.impacts) == 1),
        *[f"contact is taken to be {prepared.signal.phase.words}"] * prepared.signal.phase.known,
    ]
    for said in filter(None, words):
        echo(nouns(said))
    return codes_of(words)
