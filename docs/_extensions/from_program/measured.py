"""Tables and sentences of the evidence, from the raw results that the benchmarks have kept."""

from __future__ import annotations

from evidence import summary
from evidence.pages import paragraph


def figure(name: str) -> str:
    """The figure of this name, such as ``exactness.table``, on lines of its own."""
    return paragraph(summary.figure(name))
