"""``causes``: which of the proposed causes could have made K grow with the mass."""

from __future__ import annotations

import hashlib
import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bayestissue import resources, results, runtime
from bayestissue.commands.options import Json, Out, Overwrite, Quiet, Seed, SkipBad
from bayestissue.thesis.causes.settings import SETTINGS

if TYPE_CHECKING:
    from bayestissue.thesis.causes.subject import Subject
    from bayestissue.thesis.causes.verdict import Verdict

_TABLES = ("causes", "predictive", "observed", "confusion", "reliability")


def run(
    target: Annotated[str, typer.Argument(metavar="DATASET|published")],
    out: Out,
    model: Annotated[str | None, typer.Option(metavar="NAME|FILE")] = None,
    cause: list[str] | None = None,
    campaigns: Annotated[int | None, typer.Option(min=SETTINGS.fewest_campaigns)] = None,
    method: Literal["exact", "dds"] = "exact",
    jobs: Annotated[int | None, typer.Option(min=1)] = None,
    scheduler: str | None = None,
    seed: Seed = 0,
    skip_bad: SkipBad = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Why K grows with mass: simulate each proposed cause and say which could have made the numbers.

    An interrupted run goes on where it stopped when the same command is given again.

    Args:
        target: Folder of a dataset, or "published" for the thesis's own tables.
        model: What is simulated; causes unless given.
        cause: Only this cause of the model file; may be repeated.
        campaigns: Campaigns of every cause, instead of the model file's.
        method: How a dataset's impacts are estimated, as in estimate.
        jobs: Worker processes; 1 works in this one. One per core unless given.
        scheduler: Address of a Dask scheduler that computes instead.
    """
    start = runtime.Start()
    inputs = (model,) if target == "published" else (Path(target), model)
    with results.claim(out, overwrite=overwrite, command="causes", inputs=inputs) as claimed:
        jobs = runtime.cores() if jobs is None else jobs
        runtime.configure(one_core=jobs == 1 and scheduler is None)
        import pandas as pd

        from bayestissue.commands.console import Stages, echo
        from bayestissue.report import draw_page
        from bayestissue.thesis.causes.batches import batches, run_batches
        from bayestissue.thesis.causes.specification import chosen, read_causes, require_several
        from bayestissue.thesis.causes.subject import subject
        from bayestissue.thesis.causes.verdict import judge

        file = resources.model_file("causes" if model is None else model, lambda content: "causes" in content)
        specification = chosen(read_causes(file), tuple(cause or ()), str(file))
        if campaigns is not None:
            sizes = specification.campaigns.model_copy(update={"each": campaigns})
            specification = specification.model_copy(update={"campaigns": sizes})
        what = subject(target, method=method, skip_bad=skip_bad)
        specification = what.applicable(specification)
        require_several(specification, str(file))
        work = batches(what.setting, specification, seed)
        job = [what.input_hash, method, specification.model_dump_json(), seed, runtime.versions()]
        fingerprint = hashlib.sha256(json.dumps(job).encode()).hexdigest()
        with Stages(quiet=quiet) as say, claimed.unfinished(fingerprint) as finished:
            progress = partial(say, "simulating campaigns")
            tables = run_batches(work, jobs=jobs, scheduler=scheduler, folder=finished, progress=progress)
            say("comparing the causes", 0, 1)
            simulated = pd.concat(tables, ignore_index=True)
            verdict = judge(simulated, what.observed, specification, level_known=what.level_known, seed=seed)
            with claimed.folder() as folder:
                say("writing the results", 0, 1)
                for name in _TABLES:
                    getattr(verdict, name).to_csv(folder / f"{name}.csv", index=False)
                simulated.insert(1, "seed", seed)
                simulated.to_parquet(folder / "campaigns.parquet", index=False)
                record = start.record(
                    "causes",
                    "causes",
                    subject=what.description,
                    model=specification.model_dump(mode="json", exclude_none=True),
                    seed=seed,
                    input_hash=what.input_hash,
                    campaigns=len(simulated),
                    log_score=verdict.log_score,
                    computed_by=_by(jobs, scheduler),
                )
                results.write_json(record, folder / "run.json")
        draw_page(claimed.path)
        if as_json:
            echo(verdict.causes.to_json(orient="records", force_ascii=False))
        elif not quiet:
            _print(verdict, what, claimed.path)


def _by(jobs: int, scheduler: str | None) -> str:
    if scheduler is not None:
        return "Dask cluster"
    return "one process" if jobs == 1 else f"{jobs} worker processes"


def _print(verdict: Verdict, what: Subject, out: Path) -> None:
    from bayestissue.commands.console import line, show, table

    headings = ("cause", "p", "posterior", "±", "verdict")
    rows = []
    for row in verdict.causes.to_dict("records"):
        small = "<" if row["p_joint"] <= row["smallest_p"] else ""
        shares = (f"{row[name]:.3f}" for name in ("probability", "probability_error"))
        rows.append((row["title"], f"{small}{row['p_joint']:.2g}", *shares, row["verdict"]))
    title = f"{what.title}: could this cause have made the numbers?"
    show(table(title, headings, rows, words=("cause", "verdict")))
    line(f"wrote {out / 'causes.csv'} and {out / 'report.html'}")
