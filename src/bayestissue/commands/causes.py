"""``causes``: which of the proposed causes could have made K grow with the mass."""

from __future__ import annotations

import hashlib
import json
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from bayestissue import resources, results, runtime

if TYPE_CHECKING:
    from bayestissue.inference.points.fit import Method
    from bayestissue.thesis.causes.subject import Subject
    from bayestissue.thesis.causes.verdict import Verdict

_TABLES = ("causes", "predictive", "observed", "confusion", "reliability")


def run(
    target: str,
    *,
    out: Path,
    model: str | Path | None,
    only: tuple[str, ...],
    campaigns: int | None,
    method: Method,
    jobs: int | None,
    scheduler: str | None,
    seed: int,
    skip_bad: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Simulate campaigns of every cause, compare them with what was observed, and write the report.

    Writes ``causes.csv``, ``campaigns.parquet``, ``predictive.csv``, ``observed.csv``, ``confusion.csv``,
    ``reliability.csv``, ``run.json`` and ``report.html``. Finished batches of an interrupted run wait in a
    folder beside ``out``; the same command goes on from there.

    Raises:
        InputError: the dataset, the specification, the scheduler or ``out`` are not usable.
    """
    started, clock = datetime.now(UTC), time.perf_counter()
    inputs = (model,) if target == "published" else (Path(target), model)
    with results.claim(out, overwrite=overwrite, command="causes", inputs=inputs) as place:
        jobs = runtime.cores() if jobs is None else jobs
        runtime.configure(one_core=jobs == 1 and scheduler is None)
        import pandas as pd

        from bayestissue.commands.console import Stages, echo
        from bayestissue.report import draw_page
        from bayestissue.thesis.causes.batches import batches, run_batches
        from bayestissue.thesis.causes.specification import chosen, read_causes, require_several
        from bayestissue.thesis.causes.subject import subject
        from bayestissue.thesis.causes.verdict import judge

        model = resources.model_file(
            "causes" if model is None else model, lambda content: "causes" in content
        )
        specification = chosen(read_causes(model), only, str(model))
        if campaigns is not None:
            sizes = specification.campaigns.model_copy(update={"each": campaigns})
            specification = specification.model_copy(update={"campaigns": sizes})
        what = subject(target, method=method, skip_bad=skip_bad)
        specification = what.applicable(specification)
        require_several(specification, str(model))
        work = batches(what.setting, specification, seed)
        job = [what.input_hash, method, specification.model_dump_json(), seed, runtime.versions()]
        fingerprint = hashlib.sha256(json.dumps(job).encode()).hexdigest()
        with Stages(quiet=quiet) as say, place.unfinished(fingerprint) as kept:
            tables = run_batches(
                work,
                jobs=jobs,
                scheduler=scheduler,
                folder=kept,
                progress=lambda done, total: say("simulating campaigns", done, total),
            )
            say("comparing the causes", 0, 1)
            simulated = pd.concat(tables, ignore_index=True)
            verdict = judge(simulated, what.observed, specification, level_known=what.level_known, seed=seed)
            with place.folder() as folder:
                say("writing the results", 0, 1)
                for name in _TABLES:
                    getattr(verdict, name).to_csv(folder / f"{name}.csv", index=False)
                simulated.insert(1, "seed", seed)
                simulated.to_parquet(folder / "campaigns.parquet", index=False)
                about = {
                    "program": "bayestissue",
                    "command": "causes",
                    "kind": "causes",
                    "subject": what.description,
                    "versions": runtime.versions(),
                    "model": specification.model_dump(mode="json", exclude_none=True),
                    "seed": seed,
                    "input_hash": what.input_hash,
                    "campaigns": len(simulated),
                    "log_score": verdict.log_score,
                    "computed_by": _by(jobs, scheduler),
                    "started": started.isoformat(timespec="seconds"),
                    "wall_time_s": round(time.perf_counter() - clock, 1),
                }
                results.write_json(about, folder / "run.json")
        draw_page(place.path)
        if as_json:
            echo(verdict.causes.to_json(orient="records", force_ascii=False))
        elif not quiet:
            _print(verdict, what, place.path)


def _by(jobs: int, scheduler: str | None) -> str:
    if scheduler is not None:
        return "Dask cluster"
    return "one process" if jobs == 1 else f"{jobs} worker processes"


def _print(verdict: Verdict, what: Subject, out: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from bayestissue.commands.console import plain

    console = Console(highlight=False)
    shown = Table(title=plain(f"{what.title}: could this cause have made the numbers?"), title_justify="left")
    for heading in ("cause", "p", "posterior", "±", "verdict"):
        shown.add_column(heading, justify="left" if heading in ("cause", "verdict") else "right")
    for row in verdict.causes.to_dict("records"):
        small = "<" if row["p_joint"] <= row["smallest_p"] else ""
        shown.add_row(
            plain(row["title"]),
            f"{small}{row['p_joint']:.2g}",
            f"{row['probability']:.3f}",
            f"{row['probability_error']:.3f}",
            plain(row["verdict"]),
        )
    console.print(shown)
    console.print(plain(f"wrote {out / 'causes.csv'} and {out / 'report.html'}"), soft_wrap=True)
