"""Commands that stay until Ctrl-C: `bayestissue watch` judges each drop, `open` shows a page that answers."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from bayestissue.base.errors import InputError
from bayestissue.base.results.output_folder import locked, locked_folder
from bayestissue.base.runtime import configure
from bayestissue.commands.delivery import Port, Quiet


def watch(
    recordings: Annotated[Path, typer.Argument(metavar="RECORDINGS")],
    campaign: Annotated[Path, typer.Option()],
    out: Path | None = None,
    plan: Annotated[Path | None, typer.Option(metavar="PLANDIR")] = None,
    plain: bool = False,
    once: bool = False,
    port: Port = 0,
    poll_s: Annotated[float, typer.Option(min=0.05, max=60)] = 0.4,
    quiet: Quiet = False,
) -> None:
    """Judge each drop while it is measured: good, or again and why, with its K and C.

    The recordings are copied into a dataset that `check`, `estimate` and `fit` read at any time. Stop it by
    Ctrl-C; the same command goes on from there. Which drops were left out, and why, stands in left_out.csv.

    Args:
        recordings: The folder that a recorder writes to; nothing in it is changed.
        campaign: How its files are read, and what is wanted of drops.
        out: Folder of the dataset: new, or that of an earlier watch, which goes on; that of the recordings
            with -dataset behind unless given.
        plan: A finished plan: how many drops are left and which is next.
        plain: Lines on the terminal, and no page.
        once: Take what lies there, and end; lines alone, as with --plain.
        poll_s: Seconds between looks at the folder.
    """
    configure()
    from bayestissue.commands.console import echo
    from bayestissue.studies.bench.campaign_file import read_campaign
    from bayestissue.studies.bench.drops import Drops
    from bayestissue.studies.bench.order import order_of
    from bayestissue.studies.bench.watching import Watch
    from bayestissue.studies.init import default_out

    plain = plain or once
    read = read_campaign(campaign)
    order = order_of(read, plan)
    if not recordings.is_dir():
        raise InputError.stated("no-campaign.folder", str(recordings), value="no such folder")
    if plain and (unknown := read.unknown(order.rows)):
        names = " and ".join(unknown)
        raise InputError.stated("no-campaign.facts", str(campaign), value="not known", names=names)
    if not plain:
        from bayestissue.studies.bench.server import require_server

        require_server("bayestissue watch", " `bayestissue watch --plain` needs none.")
    say = (lambda _: None) if quiet else echo
    folder = out or default_out(recordings)
    with locked_folder(folder, (recordings, campaign, plan)):
        watching = Watch(recordings, read, Drops(folder, read), order, say)
        say(f"{len(watching.drops.drops)} drops so far in {folder}; getting ready, some seconds ...")
        watching.warm_up()
        say(f"ready: watching {recordings}")
        if once:
            watching.catch_up(poll_s)
            return

        def work() -> None:
            watching.look()
            time.sleep(poll_s)

        if plain:
            while True:
                work()
        from bayestissue.studies.bench.server import serve
        from bayestissue.studies.bench.views import WatchView

        serve(WatchView(watching), port, echo, work)


def open_(
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
    from bayestissue.commands.console import echo
    from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
    from bayestissue.studies.bench.server import require_server, serve

    is_run = (folder / "run.json").is_file()
    if not is_run and not (folder / SETTINGS).is_file():
        value = "neither" if folder.is_dir() else "a file" if folder.exists() else "no such folder"
        raise InputError.stated("not-a-run.open", str(folder), value=value)
    require_server("bayestissue open")
    with ExitStack() as locks:
        if not is_run:
            from bayestissue.studies.bench.views import DatasetView

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
        from bayestissue.studies.bench.run_view import RunView, decisions_on
        from bayestissue.studies.finished import read_run

        fit, decisions, why_not = read_run(folder), None, ""
        try:
            decisions = decisions_on(fit, dataset)
            locks.enter_context(locked(decisions.folder))
        except InputError as error:
            decisions, why_not = None, f"Questions only: no impact can be left out here. {error.problems[0]}"
            echo(why_not)
        serve(RunView(fit, decisions, why_not), port, echo)
