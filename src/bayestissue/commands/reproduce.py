"""``reproduce``: recompute, audit and re-analyse the published estimates, and write the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayestissue import resources, results, runtime
from bayestissue.commands.options import FAILED_DIAGNOSTICS, Out, Overwrite, Quiet, Seed

if TYPE_CHECKING:
    import pandas as pd


def run(
    out: Out,
    model: Annotated[str | None, typer.Option(metavar="NAME|FILE")] = None,
    seed: Seed = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Recompute, audit and re-analyse the thesis's published estimates, and write the report.

    Args:
        model: Model of the re-analysis; published unless given.
    """
    with results.claim(out, overwrite=overwrite, command="reproduce", inputs=(model,)) as target:
        runtime.configure()
        from bayestissue.commands.console import Stages, echo, explained
        from bayestissue.dataset.published import read_published
        from bayestissue.hierarchy.specification import read_specification
        from bayestissue.inference.samplers.diagnostics import verdict_in_words, warned_codes
        from bayestissue.report import draw_page
        from bayestissue.thesis.audit import audit_published
        from bayestissue.thesis.reanalysis.analysis import analyse, competing_designs
        from bayestissue.thesis.reanalysis.observations import published_design, published_observations
        from bayestissue.thesis.reproduction import reproduce_published

        start = runtime.Start()
        file = resources.model_file(
            "published" if model is None else model,
            lambda content: content.get("likelihood") == "published-estimates",
        )
        specification = read_specification(file)
        tables = read_published()
        observations = published_observations(tables)
        design = published_design(observations, specification, source=str(file))
        competing = competing_designs(observations, specification, str(file))
        with Stages(quiet=quiet) as say, target.folder() as folder:
            say("recomputing what was published", 0, 1)
            _write(reproduce_published(tables), folder / "reproduction.csv")
            say("auditing the publication", 0, 1)
            _write(audit_published(tables), folder / "audit.csv")
            analysis = analyse(observations, design, competing, specification, seed, say)
            say("writing the results", 0, 1)
            results.write_tree(analysis.tree, folder / "posterior.nc")
            for name in ("summary", "hypotheses", "comparison", "sensitivity", "predictive_checks"):
                _write(getattr(analysis, name), folder / f"{name}.csv")
            results.write_json(analysis.diagnostics, folder / "diagnostics.json")
            words = verdict_in_words(analysis.diagnostics)
            record = start.record(
                "reproduce",
                "published",
                model=specification.model_dump(mode="json") | design.resolved(),
                terms_left_out=design.terms_left_out(),
                seed=seed,
                input_hash=runtime.content_hash([*tables.paths, file]),
                verdict={"passed": analysis.diagnostics["passed"], "words": words},
            )
            results.write_json(record, folder / "run.json")
        draw_page(target.path)
        if not quiet:
            echo(words)
            explained(warned_codes(analysis.diagnostics))
            echo(f"wrote {target.path / 'report.html'}")
        if not analysis.diagnostics["passed"]:
            raise typer.Exit(FAILED_DIAGNOSTICS)


def _write(table: pd.DataFrame, path: Path) -> None:
    booleans = table.select_dtypes(["bool", "boolean"]).astype("string")
    words = {str(name): column.str.lower() for name, column in booleans.items()}
    table.assign(**words).to_csv(path, index=False)
