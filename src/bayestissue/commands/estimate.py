"""`bayestissue estimate`: K and C of every impact by itself."""

from __future__ import annotations

from collections.abc import Hashable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from bayestissue.commands.options import DatasetFolder, Json, Out, Overwrite, Quiet, Scheduler, SkipBad
from bayestissue.resources import model_file
from bayestissue.results import claim, write_json, write_table
from bayestissue.results.tables import table_of_rows
from bayestissue.runtime import Start, configure

if TYPE_CHECKING:
    import pandas as pd

    from bayestissue.dataset import Dataset
    from bayestissue.inference.single.estimates import Method
    from bayestissue.signal import SignalOptions


def run(
    dataset: DatasetFolder,
    out: Out,
    method: Literal["impact", "dds"] = "impact",
    model: Annotated[str | None, typer.Option(metavar="NAME|FILE")] = None,
    vary: list[str] | None = None,
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
        model: A model, by name or as a file, as in fit; its [signal] table says how x is made from the
            recording.
        vary: Also tabulate K and C over the values of a signal choice: window, contact, filter.
    """
    start = Start()
    with claim(out, overwrite=overwrite, command="estimate", inputs=(dataset, model)) as target:
        configure()
        from bayestissue.commands.console import Stages, echo
        from bayestissue.dataset import read_dataset
        from bayestissue.inference.execution.workers import on_cluster
        from bayestissue.inference.points.estimates import THESIS
        from bayestissue.inference.single.estimates import estimate
        from bayestissue.report.estimates_page import page_of
        from bayestissue.report.run_folder import draw_page
        from bayestissue.signal import SignalOptions, alternatives, displacements, read_signal_options
        from bayestissue.simulation.centring import centring_table

        file = None if model is None else model_file(model, lambda content: "signal" in content)
        options = THESIS if method == "dds" else SignalOptions()
        if file:
            options = read_signal_options(file)
        choices = {choice: alternatives(choice, options) for choice in vary or ()}
        data = read_dataset(dataset, skip_bad=skip_bad)
        with on_cluster(scheduler), Stages(quiet=quiet, patience_s=30.0) as say:
            table = estimate(data, method=method, options=options, say=say)
            varied = _varied(data, method, choices) if choices else None
        with target.folder() as staging:
            tables = {"estimates": table}
            if varied is not None:
                tables["vary"] = varied
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
            _print(data, table, varied, target.path)


def _varied(data: Dataset, method: Method, choices: dict[str, tuple[SignalOptions, ...]]) -> pd.DataFrame:
    """Median K and C, the middle nine tenths, and the number of impacts with an estimate, per choice."""
    import pandas as pd

    from bayestissue.errors import InputError
    from bayestissue.inference.points.notes import people_alone
    from bayestissue.inference.single.estimates import estimates
    from bayestissue.signal import displacements

    rows: list[dict[str, Any]] = []
    for choice, options in choices.items():
        for option in options:
            row: dict[str, Any] = {"choice": choice, "value": str(getattr(option, choice))}
            try:
                table = people_alone(estimates(data, displacements(data, option), method, option))
            except InputError as error:
                rows.append({**row, "note": "; ".join(str(problem) for problem in error.problems[:1])})
                continue
            row["estimated"] = int(table["K_N_per_m"].notna().sum())
            for name in ("K_N_per_m", "C_N_s_per_m"):
                low, median, high = table[name].quantile([0.05, 0.5, 0.95])
                row |= {f"{name}_median": median, f"{name}_5": low, f"{name}_95": high}
            rows.append({**row, "note": ""})
    return pd.DataFrame(rows)


def _print(data: Dataset, estimates: pd.DataFrame, varied: pd.DataFrame | None, out: Path) -> None:
    from bayestissue.commands.console import echo, explained, line, show, table
    from bayestissue.inference.points.notes import people_alone, said_once
    from bayestissue.outline import counted
    from bayestissue.remedies import codes_in
    from bayestissue.report.wording import estimated

    flagged = int((estimates["flags"] != "").sum())
    rows, people = [], people_alone(estimates)
    for name, words in (("K_N_per_m", "K (N/m)"), ("C_N_s_per_m", "C (N s/m)"), ("zeta", "zeta")):
        low, median, high = people[name].quantile([0.05, 0.5, 0.95])
        rows.append((words, *estimated(median, low, high)))
    which = "these impacts" if len(people) == len(estimates) else "people's impacts"
    title = f"{data.name}: {len(estimates)} impacts, {flagged} flagged"
    show(table(title, (which, "median", "5 % below", "95 % below"), rows))
    for sentence in said_once(estimates["notes"]):
        line(sentence)
    if varied is not None:
        title = "K and C against each choice: the median impact (nine in ten impacts)"
        headings = ("choice", "value", "impacts", "K (N/m)", "C (N s/m)")
        show(table(title, headings, map(_vary_row, varied.to_dict("records")), words=headings))
    if data.left_out:
        count = len({problem.impact for problem in data.left_out})
        echo(f"{counted(count, 'impact')} left out: see left_out.csv")
    texts = "; ".join([*estimates["flags"], *estimates["notes"]])
    explained([*codes_in(texts), *(problem.code for problem in data.left_out)])
    line(f"wrote {out / 'estimates.csv'} and {out / 'report.html'}")


def _vary_row(row: dict[Hashable, Any]) -> list[str]:
    from bayestissue.report.wording import estimated

    if row["note"]:
        return [row["choice"], row["value"], "", row["note"], ""]
    levels = (
        "{} ({} to {})".format(*estimated(*(row[f"{name}_{end}"] for end in ("median", "5", "95"))))
        for name in ("K_N_per_m", "C_N_s_per_m")
    )
    return [row["choice"], row["value"], f"{row['estimated']:.0f}", *levels]
