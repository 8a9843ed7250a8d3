"""All that a paper takes from a finished fit, in one folder: texts, checklists, workbook, figures."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from bayestissue.base.outline import markdown_rows
from bayestissue.base.results.tables import write_table
from bayestissue.base.words import PLAIN, Words
from bayestissue.reports.figures.theme import Figure, Specification
from bayestissue.reports.pages.fit.figures import published
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.paper import PRINT, WIDTH_MM
from bayestissue.reports.paper.checklists import checklists, checklists_markdown
from bayestissue.reports.paper.text import Text, text_of
from bayestissue.reports.paper.workbook import write_workbook

# What stands for itself in a text, and for something else in Markdown or HTML.
_MARKUP = re.compile(
    r"[\\`*]|<(?=[A-Za-z/!?])|&(?=#?\w+;)|(?<!\w)_|_(?!\w)|~(?=~)|\](?=[(\[])|^\[(?=[^\]]*\]:)"
)
# Word's limit of a document's property.
LONGEST_TITLE = 255
_CAPTION = "Posterior medians and 90 % intervals."
# Of CSS and of PostScript.
PIXELS_PER_INCH, POINTS_PER_INCH = 96, 72
_SIZE = re.compile(r'width="([\d.]+)" height="([\d.]+)"')


def write_paper(
    run: FitRun, folder: Path, *, certified: Mapping[str, Any] | None = None, width_mm: float = WIDTH_MM
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


def write_markdown(text: Text, path: Path) -> None:
    """Write the text as Markdown, UTF-8."""
    parts = [f"# {_escaped(text.title)}"]
    for heading, paragraphs in text.sections.items():
        parts += [f"## {heading}", *map(_escaped, paragraphs)]
    if len(text.table):
        rows = (map(_escaped, row) for row in text.table.to_numpy().tolist())
        lines = markdown_rows(tuple(map(_escaped, text.table.columns)), rows)
        parts += ["\n".join(lines), f"Table 1. {_CAPTION}"]
    references = (f"{number}. {_escaped(words)}" for number, words in enumerate(text.references, start=1))
    parts += ["## References", "\n".join(references)]
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _escaped(words: str) -> str:
    """A plain text as a line of Markdown: what a name holds of Markdown or HTML is shown, not obeyed."""
    return _MARKUP.sub(r"\\\g<0>", " ".join(words.splitlines()))


def write_word(text: Text, path: Path) -> None:
    """Write the text as a Word document with its styles of headings, tables and numbered lists."""
    from docx import Document

    document = Document()
    document.core_properties.title = text.title[:LONGEST_TITLE]
    document.core_properties.author = ""
    document.add_heading(text.title, level=0)
    for heading, paragraphs in text.sections.items():
        document.add_heading(heading, level=1)
        for paragraph in paragraphs:
            document.add_paragraph(paragraph)
    if len(text.table):
        document.add_paragraph(f"Table 1. {_CAPTION}", style="Caption")
        table = document.add_table(rows=0, cols=text.table.shape[1], style="Light List")
        for row in [list(text.table.columns), *text.table.to_numpy().tolist()]:
            for cell, words in zip(table.add_row().cells, row, strict=True):
                cell.text = words
    document.add_heading("References", level=1)
    for words in text.references:
        document.add_paragraph(words, style="List Number")
    document.save(str(path))


def write_figures(
    figures: Iterable[tuple[str, Callable[[], Figure]]],
    folder: Path,
    *,
    nouns: Words = PLAIN,
    width_mm: float = WIDTH_MM,
) -> None:
    """Write ``NAME.svg``, ``NAME.pdf``, ``NAME.png`` (300 dots an inch) and ``NAME.csv`` of each figure.

    Args:
        figures: a name fit for a file, and what makes the figure.
        folder: that exists.
        nouns: what the dataset calls people, conditions and impacts.
        width_mm: of each figure, in print.
    """
    import vl_convert

    in_print = POINTS_PER_INCH / PIXELS_PER_INCH
    for name, make in figures:
        figure = make()
        svg = _drawn(nouns.chart(figure.specification()), width_mm / 25.4 * PIXELS_PER_INCH)
        (folder / f"{name}.svg").write_text(svg, encoding="utf-8")
        # A unit of the drawing is a point of the page there, and not a pixel.
        points = _SIZE.sub(lambda size: _size(size, in_print), svg, count=1)
        (folder / f"{name}.pdf").write_bytes(vl_convert.svg_to_pdf(points))
        (folder / f"{name}.png").write_bytes(
            vl_convert.svg_to_png(svg, scale=in_print, ppi=PRINT.dots_per_inch)
        )
        write_table(figure.data, folder / f"{name}.csv")


def _drawn(chart: Specification, pixels: float) -> str:
    """The chart as SVG, so wide with titles and labels."""
    import vl_convert

    # A legend of three columns is wider than a journal's.
    chart["config"] = chart["config"] | {"legend": chart["config"]["legend"] | {"columns": 2}}
    if "vconcat" in chart:
        chart["vconcat"] = [panel | {"width": pixels - PRINT.label_pixels} for panel in chart["vconcat"]]
    elif "facet" in chart:
        # One panel below the other, as in a column of a journal there is room for one.
        across = max(1, min(chart["columns"], int(pixels // PRINT.panel_pixels)))
        width = pixels / across - PRINT.label_pixels
        chart |= {"columns": across, "spec": chart["spec"] | {"width": width}}
    else:
        chart |= {"width": pixels, "autosize": {"type": "fit-x", "contains": "padding"}}
    svg = vl_convert.vegalite_to_svg(chart)
    # Where a legend makes it wider all the same, it is drawn so much smaller.
    return _SIZE.sub(lambda size: _size(size, pixels / float(size.group(1))), svg, count=1)


def _size(size: re.Match[str], factor: float) -> str:
    width, height = (factor * float(length) for length in size.groups())
    return f'width="{width:.2f}" height="{height:.2f}"'
