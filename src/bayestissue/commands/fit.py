"""``fit``: the posterior of K and C from recorded traces, and its report."""

from __future__ import annotations

import json
import shutil
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bayestissue import resources, results, runtime

if TYPE_CHECKING:
    from bayestissue.dataset import Dataset
    from bayestissue.hierarchy.specification import ModelSpecification

TABLES = ("summary", "hypotheses", "cross_validation", "sensitivity")


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
    started, clock = datetime.now(UTC), time.perf_counter()
    results.require_free(out, overwrite=overwrite)
    runtime.configure(one_core=True)
    from bayestissue.commands.console import Stages
    from bayestissue.dataset import read_dataset
    from bayestissue.hierarchy.specification import read_specification
    from bayestissue.hierarchy.trace_data import prepare
    from bayestissue.inference.diagnostics import verdict_in_words
    from bayestissue.inference.estimates import estimate
    from bayestissue.inference.traces import fit_traces
    from bayestissue.report import write_report

    model = model or resources.shared("models", "arma.toml")
    specification = read_specification(model)
    data = read_dataset(dataset, skip_bad=skip_bad)
    prepared = prepare(data, specification, source=str(model))
    job = _fingerprint(data, specification, seed)
    kept = _checkpoints(out, job)
    with Stages(quiet=quiet) as say:
        try:
            analysis = fit_traces(prepared, specification, seed, say, checkpoints=kept)
        except KeyboardInterrupt:
            if not quiet:
                typer.echo("interrupted; run the same command again to go on from here", err=True)
            raise
        say("writing the results", 0, 1)
        with results.whole_folder(out, overwrite=overwrite) as folder:
            analysis.tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
            for name in TABLES:
                getattr(analysis, name).to_csv(folder / f"{name}.csv", index=False)
            for method in ("exact", "dds"):
                estimate(data, method=method).to_csv(folder / f"estimates_{method}.csv", index=False)
            _copy_truth(data, folder)
            _write_json(analysis.diagnostics, folder / "diagnostics.json")
            words = verdict_in_words(analysis.diagnostics)
            provenance = {
                "program": "bayestissue",
                "command": "fit",
                "kind": "fit",
                "dataset": data.name,
                "description": data.description,
                "quantity": data.quantity,
                "versions": runtime.versions(),
                "model": specification.model_dump(mode="json")
                | {"reference_mass_kg": prepared.design.reference_mass_kg},
                "uncertainty": vars(data.uncertainty),
                "left_out": [str(problem) for problem in data.left_out],
                "seed": seed,
                "input_hash": data.input_hash,
                "started": started.isoformat(timespec="seconds"),
                "wall_time_s": round(time.perf_counter() - clock, 1),
                "verdict": {"passed": analysis.diagnostics["passed"], "words": words},
            }
            _write_json(provenance, folder / "run.json")
            say("writing the report", 0, 1)
            write_report(folder)
    shutil.rmtree(kept, ignore_errors=True)
    if not quiet:
        typer.echo(f"{words}\nwrote {out / 'report.html'}")
    return bool(analysis.diagnostics["passed"])


def _fingerprint(data: Dataset, specification: ModelSpecification, seed: int) -> str:
    """What must be the same for a checkpoint to be one of this job."""
    import hashlib

    content = [data.input_hash, specification.model_dump_json(), seed, runtime.versions()]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _checkpoints(out: Path, job: str) -> Path:
    """The folder of this job's checkpoints, emptied if they are another job's."""
    out = out.absolute()
    folder = out.parent / f".{out.name}.unfinished"
    mark = folder / "job"
    if folder.is_dir() and not (mark.is_file() and mark.read_text(encoding="utf-8") == job):
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with results.whole_file(mark) as staging:
        staging.write_text(job, encoding="utf-8")
    return folder


def _copy_truth(data: Dataset, folder: Path) -> None:
    """A simulated dataset knows the truth; the report draws it in."""
    truth = data.folder / "truth.csv"
    if truth.is_file():
        shutil.copyfile(truth, folder / "truth.csv")


def _write_json(content: dict[str, Any], path: Path) -> None:
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
