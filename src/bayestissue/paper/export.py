"""All that a paper takes from a finished fit, in one folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import xarray as xr

from bayestissue.paper.documents import write_markdown, write_word
from bayestissue.paper.text import text_of
from bayestissue.paper.workbook import write_workbook
from bayestissue.report.fit.run import FitRun


def write_paper(
    run: FitRun,
    folder: Path,
    *,
    table: Callable[[str], pd.DataFrame],
    posterior: xr.Dataset,
    rows: pd.DataFrame,
) -> None:
    """Write ``methods.md``, ``methods.docx`` and ``tables.xlsx`` into ``folder``.

    Args:
        run: a finished fit, whatever its diagnostics say: the text says it too.
        folder: that exists.
        table: a table of the fit by its name; a KeyError where there is none.
        posterior: the draws, with the dimensions ``chain`` and ``draw``.
        rows: what was recorded of each impact, in the order of ``posterior``.
    """
    text = text_of(run)
    write_markdown(text, folder / "methods.md")
    write_word(text, folder / "methods.docx")
    write_workbook(folder / "tables.xlsx", table, posterior, rows, run.record["model"])
