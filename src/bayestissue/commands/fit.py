"""``fit``: the posterior of K and C from recorded traces, and its report."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bayestissue import results, runtime
from bayestissue.inference.second_core import SecondCore

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset
    from bayestissue.hierarchy.specification import ModelSpecification


def run(
    dataset: Path,
    *,
    out: Path,
    model: Path | None,
    seed: int,
    skip_bad: bool,
    overwrite: bool,
    quiet: bool,
) -> bool:
    """Write a finished fit to ``out`` and return whether the sampler's diagnostics passed.

    Finished parts of an interrupted fit wait in a folder beside ``out``; the same command goes on from
    there, with the draws that it would have given without the interruption.

    Raises:
        InputError: the dataset, the model file or ``out`` are not usable; before any sampling.
    """
    results.require_free(out, overwrite=overwrite)
    runtime.configure(one_core=True)
    with SecondCore() as core:
        core.start()
        from bayestissue.commands.console import Stages
        from bayestissue.dataset import read_dataset
        from bayestissue.fitting import fit_prepared, resolve, write_run
        from bayestissue.hierarchy.trace_data import prepare
        from bayestissue.inference.diagnostics import headline

        specification, source = resolve("arma" if model is None else model)
        data = read_dataset(dataset, skip_bad=skip_bad)
        prepared = prepare(data, specification, source=source)
        kept = results.unfinished(out, _fingerprint(data, specification, seed))
        with Stages(quiet=quiet) as say:
            try:
                fit = fit_prepared(data, specification, prepared, seed, say, checkpoints=kept, core=core)
            except KeyboardInterrupt:
                if not quiet:
                    typer.echo("interrupted; run the same command again to go on from here", err=True)
                raise
            with results.whole_folder(out, overwrite=overwrite) as folder:
                write_run(fit, folder, say)
        shutil.rmtree(kept, ignore_errors=True)
        if not quiet:
            typer.echo(f"{headline(fit.diagnostics)} {fit.verdict}\nwrote {out / 'report.html'}")
        return bool(fit.diagnostics["passed"])


def _fingerprint(data: Dataset, specification: ModelSpecification, seed: int) -> str:
    """What must be the same for a checkpoint to be one of this job."""
    import hashlib

    content = [data.input_hash, specification.model_dump_json(), seed, runtime.versions()]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()
