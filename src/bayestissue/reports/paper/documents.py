"""A text as Markdown and as a Word document."""

from __future__ import annotations

import re
from pathlib import Path

from bayestissue.reports.paper.text import Text

# What stands for itself in a text, and for something else in Markdown or HTML.
_MARKUP = re.compile(
    r"[\\`*]|<(?=[A-Za-z/!?])|&(?=#?\w+;)|(?<!\w)_|_(?!\w)|~(?=~)|\](?=[(\[])|^\[(?=[^\]]*\]:)"
)
# Word's limit of a document's property.
LONGEST_TITLE = 255
_CAPTION = "Posterior medians and 90 % intervals."


def write_markdown(text: Text, path: Path) -> None:
    """Write the text as Markdown, UTF-8."""
    parts = [f"# {_escaped(text.title)}"]
    for heading, paragraphs in text.sections.items():
        parts += [f"## {heading}", *map(_escaped, paragraphs)]
    if len(text.table):
        rows = [list(text.table.columns), ["---"] * text.table.shape[1], *text.table.to_numpy().tolist()]
        lines = (" | ".join(_escaped(cell).replace("|", "\\|") for cell in row) for row in rows)
        parts += ["\n".join(f"| {line} |" for line in lines), f"Table 1. {_CAPTION}"]
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
