"""Markdown of text that was not written as such, and of tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_CODE = re.compile(r"(``[^`]+``|`[^`]+`)")


def escaped(text: str) -> str:
    """Words as they stand: what is no code and would be marks of Markdown is escaped."""
    parts = _CODE.split(text)
    parts[::2] = [re.sub(r"([\\*_<\[\]$])", r"\\\1", part) for part in parts[::2]]
    return "".join(parts)


def paragraphs(text: str) -> str:
    """The same of several paragraphs, of which those that are indented are code."""
    return "\n".join(line if line.startswith("    ") else escaped(line) for line in text.splitlines())


def code(text: object) -> str:
    """A name or a value; nothing if there is none."""
    return f"`{text}`" if str(text) else ""


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, stacked: bool = True) -> str:
    """A table; stacked where the screen is narrow, without its header, unless its cells need that."""
    lines = [header, ["---"] * len(header), *rows]
    cells = ("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
    about = [":class: stacked"] if stacked else []
    return "\n".join([":::{table}", *about, "", *cells, ":::", ""])
