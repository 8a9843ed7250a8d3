"""``export``: what a paper takes from a finished fit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayestissue import runtime
from bayestissue.commands.options import FinishedFit, Out, Overwrite, Quiet
from bayestissue.paper import WIDTH_MM


def run(
    run: FinishedFit,
    out: Out,
    certificate: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    width: Annotated[float, typer.Option(metavar="MM", min=40, max=400)] = WIDTH_MM,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """A finished fit for a paper: methods and results as text, all tables in one workbook, figures.

    methods.md and methods.docx hold paragraphs with this run's numbers, settings, versions and references;
    read them before you use them, and say what the program can't know: who was measured, where and why.
    tables.xlsx has every table of the run, an impact a row, and people_wide, a row a person and a column a
    side and condition, as SPSS, JASP and Excel want it; its sheet columns says what each means. figures/ has
    each figure as SVG, PDF and PNG, and the rows that it is drawn from as CSV.

    checklists.md has the checklists BARG (Bayesian analyses) and GRRAS (reliability), answered where the run
    knows the answer; the rest are questions to you.

    Args:
        certificate: Folder of `bayestissue certify` of this run, whose verdict the checklists then state.
        width: Of a figure in print; a journal's column is about 85 mm wide, its page 170.
    """
    runtime.configure()
    from bayestissue.commands.console import echo
    from bayestissue.finished import read_run

    folder = read_run(run).export(out, certificate=certificate, width_mm=width, overwrite=overwrite)
    if not quiet:
        echo(f"wrote methods.md, methods.docx, checklists.md, tables.xlsx and figures/ to {folder}")
