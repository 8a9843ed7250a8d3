"""`bayestissue open`: a finished fit, or the impacts of a dataset, on a page that answers."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from bayestissue.commands.options import Port
from bayestissue.errors import InputError
from bayestissue.runtime import configure


def run(
    folder: Annotated[Path, typer.Argument(metavar="RUN|DATASET", show_default=False)],
    dataset: Annotated[Path | None, typer.Option(metavar="DATASET")] = None,
    port: Port = 0,
) -> None:
    """Ask a finished fit on its report, look at each impact of a dataset, and leave one out with a reason.

    Of a run: the report, with a line for questions as `bayestissue ask` takes them. Of a dataset: each impact
    with its trace, K and C by itself. On both, impacts are left out and accepted again; reasons are written
    into left_out.csv in the dataset, recordings and runs stay as they are. `check`, `estimate`, `fit` and
    their pages then do without these impacts and say why. Stop it by Ctrl-C.

    Args:
        folder: A finished run of `bayestissue fit`, or a dataset.
        dataset: Of a run: where the recordings lie now, if they were moved.
    """
    configure()
    from bayestissue.bench.server import require_server, serve
    from bayestissue.commands.console import echo
    from bayestissue.dataset.settings import FILE as SETTINGS
    from bayestissue.results import locked

    is_run = (folder / "run.json").is_file()
    if not is_run and not (folder / SETTINGS).is_file():
        value = "neither" if folder.is_dir() else "a file" if folder.exists() else "no such folder"
        raise InputError.stated("not-a-run.open", str(folder), value=value)
    require_server("bayestissue open")
    with ExitStack() as locks:
        if not is_run:
            from bayestissue.bench.views import DatasetView

            why_not = ""
            try:
                locks.enter_context(locked(folder))
                writable = os.access(folder, os.W_OK)
            except InputError as error:
                if error.problems[0].code != "out-unwritable":
                    raise
                writable = False
            if not writable:
                why_not = "to look at only: nothing can be written there"
                echo(f"{folder}: {why_not}")
            serve(DatasetView(folder, why_not), port, echo)
            return
        from bayestissue.bench.run_view import RunView, decisions_on
        from bayestissue.finished import read_run

        fit, decisions, why_not = read_run(folder), None, ""
        try:
            decisions = decisions_on(fit, dataset)
            locks.enter_context(locked(decisions.folder))
        except InputError as error:
            decisions, why_not = None, f"Questions only: no impact can be left out here. {error.problems[0]}"
            echo(why_not)
        serve(RunView(fit, decisions, why_not), port, echo)
