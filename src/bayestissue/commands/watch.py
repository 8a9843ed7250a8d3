"""`bayestissue watch`: each drop judged while the person is still there, and the dataset as it grows."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from bayestissue.commands.options import Port, Quiet
from bayestissue.errors import InputError
from bayestissue.results import locked_folder
from bayestissue.runtime import configure


def run(
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
    from bayestissue.bench.campaign import read_campaign
    from bayestissue.bench.drops import Drops
    from bayestissue.bench.order import order_of
    from bayestissue.bench.watching import Watch
    from bayestissue.commands.console import echo
    from bayestissue.intake import default_out

    plain = plain or once
    read = read_campaign(campaign)
    order = order_of(read, plan)
    if not recordings.is_dir():
        raise InputError.stated("no-campaign.folder", str(recordings), value="no such folder")
    if plain and (unknown := read.unknown(order.rows)):
        names = " and ".join(unknown)
        raise InputError.stated("no-campaign.facts", str(campaign), value="not known", names=names)
    if not plain:
        from bayestissue.bench.server import require_server

        require_server("bayestissue watch", " `bayestissue watch --plain` needs none.")
    say = (lambda _: None) if quiet else echo
    folder = out or default_out(recordings)
    with locked_folder(folder, (recordings, campaign, plan)):
        watch = Watch(recordings, read, Drops(folder, read), order, say)
        say(f"{len(watch.drops.all)} drops so far in {folder}; getting ready, some seconds ...")
        watch.warm_up()
        say(f"ready: watching {recordings}")
        if once:
            watch.catch_up(poll_s)
        elif plain:
            while True:
                watch.look()
                time.sleep(poll_s)
        else:
            from bayestissue.bench.server import serve
            from bayestissue.bench.views import WatchView

            def work() -> None:
                watch.look()
                time.sleep(poll_s)

            serve(WatchView(watch), port, echo, work)
