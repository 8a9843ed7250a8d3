"""What to do about each warning and error, as `bayestissue explain` has it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from bayestissue.base.remedies import Remedy, entries


def remedies() -> str:
    """A section for each group of entries, in which each entry has the anchor ``explain-CODE``."""
    return "\n\n".join(_lines())


def _lines() -> Iterator[str]:
    for title, group in groupby(entries().values(), key=lambda entry: entry.group):
        yield f"## {title}"
        for entry in group:
            yield from _entry(entry)


def _entry(entry: Remedy) -> Iterator[str]:
    yield f"(explain-{entry.code})=\n### {entry.title}"
    yield f"`{entry.code}`. {entry.means}"
    for heading, text in entry.parts[1:]:
        yield f"*{heading}.* {text}"
