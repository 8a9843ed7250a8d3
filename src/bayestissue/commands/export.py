"""``export``: what a paper takes from a finished fit."""

from __future__ import annotations

from bayestissue import runtime
from bayestissue.commands.options import FinishedFit, Out, Overwrite, Quiet


def run(
    run: FinishedFit,
    out: Out,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """A finished fit for a paper: methods and results as text, all tables in one workbook.

    methods.md and methods.docx hold paragraphs with this run's numbers, settings, versions and references;
    read them before you use them, and say what the program can't know: who was measured, where and why.
    tables.xlsx has every table of the run, an impact a row, and people_wide, a row a person and a column a
    side and condition, as SPSS, JASP and Excel want it; its sheet columns says what each means.
    """
    runtime.configure()
    from bayestissue.commands.console import echo
    from bayestissue.finished import read_run

    folder = read_run(run).export(out, overwrite=overwrite)
    if not quiet:
        echo(f"wrote methods.md, methods.docx and tables.xlsx to {folder}")
