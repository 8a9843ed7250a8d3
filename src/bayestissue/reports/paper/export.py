"""All that a paper takes from a finished fit, in one folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayestissue.reports.pages.fit.figures import published
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.paper import WIDTH_MM
from bayestissue.reports.paper.checklists import checklists, checklists_markdown
from bayestissue.reports.paper.documents import write_markdown, write_word
from bayestissue.reports.paper.drawings import write_figures
from bayestissue.reports.paper.text import text_of
from bayestissue.reports.paper.workbook import write_workbook


def write_paper(
    run: FitRun,
    folder: Path,
    *,
    certified: Mapping[str, Any] | None = None,
    width_mm: float = WIDTH_MM,
) -> None:
    """Write ``methods.md``, ``methods.docx``, ``checklists.md``, ``tables.xlsx`` and ``figures/``.

    Args:
        run: a finished fit, whatever its diagnostics say: the text says it too.
        folder: that exists.
        certified: the ``verdict`` of the fit's certificate, if it has one.
        width_mm: of a figure in print.
    """
    text = text_of(run, run.study)
    write_markdown(text, folder / "methods.md")
    write_word(text, folder / "methods.docx")
    lists = ["# Checklists of journals", "", *checklists_markdown(checklists(run, text, certified))]
    (folder / "checklists.md").write_text("\n".join(lists), encoding="utf-8")
    write_workbook(folder / "tables.xlsx", run.table, run.study, run.about["model"])
    (folder / "figures").mkdir()
    write_figures(published(run), folder / "figures", nouns=run.nouns, width_mm=width_mm)
