"""``fit``: the posterior of K and C from recorded traces, and its report."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayestissue import results, runtime
from bayestissue.commands.options import (
    FAILED_DIAGNOSTICS,
    DatasetFolder,
    Excel,
    FormulaOfC,
    Model,
    Out,
    Overwrite,
    Quiet,
    Scheduler,
    Seed,
    SkipBad,
)
from bayestissue.words import Words

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset
    from bayestissue.hierarchy.specification import ModelSpecification
    from bayestissue.hierarchy.trace_data import Prepared
    from bayestissue.remedies import Code


def run(
    dataset: DatasetFolder,
    out: Out,
    model: Model = None,
    K: Annotated[str | None, typer.Option("--K", metavar="FORMULA")] = None,
    C: FormulaOfC = None,
    ask: Annotated[list[str] | None, typer.Option(metavar="QUESTION")] = None,
    continue_from: Annotated[Path | None, typer.Option("--continue", metavar="RUN")] = None,
    path: str | None = None,
    scheduler: Scheduler = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    excel: Excel = None,
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
        path: Of an earlier version, which had several samplers: without effect.
    """
    runtime.configure(one_core=True)
    with results.claim(out, overwrite=overwrite, command="fit", inputs=(dataset, model)) as target:
        from bayestissue.commands.console import Stages, echo, explained
        from bayestissue.commands.finished_runs import print_answers
        from bayestissue.dataset import read_dataset
        from bayestissue.finished import CHAIN, page_html, write_run
        from bayestissue.fitting import earlier_run, fit_prepared, formulas_of, require_answerable, resolve
        from bayestissue.hierarchy.trace_data import prepare
        from bayestissue.inference.execution.workers import on_cluster
        from bayestissue.inference.samplers.diagnostics import headline, warned_codes
        from bayestissue.report import draw_page

        data = read_dataset(dataset, skip_bad=skip_bad)
        specification, source = resolve(
            model, data.recorded, formulas=formulas_of(K, C), questions=ask or [], sampler={"path": path}
        )
        if model is None and not quiet:
            echo(f"model {specification.name}, that of a recorded {data.quantity}; --model takes another")
        if specification.sampler.ignored and not quiet:
            echo(f"without effect, of an earlier sampler: {', '.join(specification.sampler.ignored)}")
        if skip_bad:
            data = _without_short(data, specification, source)
        prepared = prepare(data, specification, source=source)
        require_answerable(prepared, specification, source)
        earlier = None
        if continue_from is not None:
            earlier = earlier_run(continue_from, data, specification, prepared)
        nouns = Words(data.words)
        codes = [] if quiet else _say_what_is_told(prepared, nouns)
        # What must be the same for a checkpoint to be one of this job.
        content = [data.input_hash, specification.model_dump_json(), seed, runtime.versions()]
        if continue_from is not None:
            content.append(runtime.content_hash([continue_from / CHAIN]))
        job = hashlib.sha256(json.dumps(content).encode()).hexdigest()
        with Stages(quiet=quiet) as say:
            with on_cluster(scheduler), target.unfinished(job) as finished:
                fit = fit_prepared(
                    data, specification, prepared, seed, say, checkpoints=finished, earlier=earlier
                )
                with target.folder() as folder:
                    write_run(fit, folder, say, excel=excel)
            say("writing the report", 0, 1)
            draw_page(target.path, partial(page_html, fit))
        if not quiet:
            if specification.questions:
                print_answers(fit.questions, nouns)
            echo(nouns(f"{headline(fit.diagnostics)}\n{fit.verdict}"))
            explained([*codes, *warned_codes(fit.diagnostics)])
            echo(f"wrote {target.path / 'report.html'}")
        if not fit.diagnostics["passed"]:
            raise typer.Exit(FAILED_DIAGNOSTICS)


def _without_short(data: Dataset, specification: ModelSpecification, source: str) -> Dataset:
    """The dataset less the impacts of too few samples, which are told as left out; all of them stay."""
    import numpy as np

    from bayestissue.hierarchy.trace_data import too_short
    from bayestissue.signal import displacements

    problems = too_short(data, displacements(data, specification.signal), source)
    short = {problem.impact for problem in problems}
    keep = np.flatnonzero(~data.impacts["impact"].isin(short))
    if not problems or not len(keep):
        return data
    remaining = data.part(keep.tolist())
    impacts, left_out = remaining.impacts.reset_index(drop=True), (*data.left_out, *problems)
    return replace(remaining, impacts=impacts, left_out=left_out)


def _say_what_is_told(prepared: Prepared, nouns: Words) -> list[Code]:
    """What these data can't tell, before the work begins; the codes of what was said."""
    from bayestissue.commands.console import echo
    from bayestissue.errors import codes_of
    from bayestissue.hierarchy.formulas.formula import left_out_words
    from bayestissue.hierarchy.untried import untried, untried_words
    from bayestissue.inference.results.meanings import ONE_IMPACT, few_valued_words

    words = [
        left_out_words(prepared.design.terms_left_out()),
        *untried_words(untried(prepared.design.recorded)),
        *few_valued_words(prepared.design.few_valued()),
        *[ONE_IMPACT] * (len(prepared.impacts) == 1),
        *[f"contact is taken to be {prepared.signal.phase.words}"] * prepared.signal.phase.known,
    ]
    for said in filter(None, words):
        echo(nouns(said))
    return codes_of(words)
