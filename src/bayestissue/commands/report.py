"""`bayestissue report`: the page of a finished run, written anew."""

from __future__ import annotations

from pathlib import Path

from bayestissue.commands.console import echo
from bayestissue.report import write_report


def run(run: Path, *, quiet: bool) -> None:
    """Write ``report.html`` into the folder ``run`` and say where it is.

    Raises:
        InputError: ``run`` isn't the folder of a finished run.
    """
    path = write_report(run)
    if not quiet:
        echo(f"wrote {path}")
