"""`bayestissue report`: the page of a finished run, written anew."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayestissue.commands.options import Quiet


def run(
    run: Annotated[Path, typer.Argument(help="Folder of a finished run.", metavar="DIR")],
    quiet: Quiet = False,
) -> None:
    """Write report.html anew from the files of a finished run."""
    from bayestissue.commands.console import echo
    from bayestissue.report import write_report

    path = write_report(run)
    if not quiet:
        echo(f"wrote {path}")
