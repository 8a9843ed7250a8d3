"""`bayestissue estimate`: K and C of every impact by itself."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bayestissue.commands.options import DatasetFolder, Json, Out, Overwrite, Quiet, Scheduler, SkipBad
from bayestissue.resources import model_file
from bayestissue.results import claim, write_json, write_table
from bayestissue.results.tables import table_of_rows
from bayestissue.runtime import Start, configure

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.dataset import Dataset


def run(
    dataset: DatasetFolder,
    out: Out,
    method: Literal["impact", "dds"] = "impact",
    model: Annotated[str | None, typer.Option(metavar="NAME|FILE")] = None,
    scheduler: Scheduler = None,
    skip_bad: SkipBad = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """K and C of every impact by itself, with 90 % intervals; --method dds has the thesis's own points.

    Args:
        method: impact: the posterior of each impact given its own trace and its measuring chain. dds: the
            thesis's conditional fit about the sample mean, without intervals.
        model: A model, by name or as a file, as in fit; its [signal] table says where contact is in the
            recordings, and which part of them is used.
    """
    start = Start()
    with claim(out, overwrite=overwrite, command="estimate", inputs=(dataset, model)) as target:
        configure()
        from bayestissue.commands.console import Stages, echo
        from bayestissue.dataset import read_dataset
        from bayestissue.inference.execution.workers import on_cluster
        from bayestissue.inference.single.estimates import estimate
        from bayestissue.report.estimates_page import page_of
        from bayestissue.report.run_folder import draw_page
        from bayestissue.signal import SignalOptions, displacements, read_signal_options
        from bayestissue.simulation.centring import centring_table

        file = None if model is None else model_file(model, lambda content: "signal" in content)
        options = read_signal_options(file) if file else SignalOptions()
        data = read_dataset(dataset, skip_bad=skip_bad)
        with on_cluster(scheduler), Stages(quiet=quiet, patience_s=30.0) as say:
            table = estimate(data, method=method, options=options, say=say)
        with target.folder() as staging:
            tables = {"estimates": table}
            if method == "dds":
                # What this fit makes of one tissue under several masses, so that readers can judge their own.
                tables["centring"] = centring_table()
            if data.left_out:
                rows = [problem.as_dict() for problem in data.left_out]
                tables["left_out"] = table_of_rows("left_out", rows).astype({"row": "Int64"})
            for name, content in tables.items():
                write_table(content, staging / f"{name}.csv")
            record = start.record(
                "estimate",
                "estimates",
                dataset=data.name,
                method=method,
                words=dict(data.words),
                model={"file": file.name if file else None, "signal": options.model_dump()},
                contact=displacements(data, options).phase.words,
                input_hash=data.input_hash,
            )
            write_json(record, staging / "run.json")
        draw_page(target.path, partial(page_of, tables, record))
        if as_json:
            echo(table.to_json(orient="records", force_ascii=False))
        elif not quiet:
            _print(data, table, target.path)


def _print(data: Dataset, estimates: pd.DataFrame, out: Path) -> None:
    from bayestissue.commands.console import echo, explained, line, show, table
    from bayestissue.inference.points.notes import people_alone, said_once
    from bayestissue.outline import counted
    from bayestissue.remedies import codes_in, entries
    from bayestissue.report.wording import estimated

    flagged = int((estimates["flags"] != "").sum())
    rows, people = [], people_alone(estimates)
    for name, words in (("K_N_per_m", "K (N/m)"), ("C_N_s_per_m", "C (N s/m)"), ("zeta", "zeta")):
        low, median, high = people[name].quantile([0.05, 0.5, 0.95])
        rows.append((words, *estimated(median, low, high)))
    which = "these impacts" if len(people) == len(estimates) else "people's impacts"
    title = f"{data.name}: {counted(len(estimates), 'impact')}, {flagged} flagged"
    show(table(title, (which, "median", "5 % below", "95 % below"), rows))
    if estimates["K_N_per_m"].isna().all():
        remedies = (entries()[code] for code in codes_in("; ".join(estimates["flags"])))
        line(" ".join(["No impact has K.", *(f"{entry.title}: {entry.remedy}" for entry in remedies)]))
    for sentence in said_once(estimates["notes"]):
        line(sentence)
    if data.left_out:
        count = len({problem.impact for problem in data.left_out})
        echo(f"{counted(count, 'impact')} left out: see left_out.csv")
    texts = "; ".join([*estimates["flags"], *estimates["notes"]])
    explained([*codes_in(texts), *(problem.code for problem in data.left_out)])
    line(f"wrote {out / 'estimates.csv'} and {out / 'report.html'}")
