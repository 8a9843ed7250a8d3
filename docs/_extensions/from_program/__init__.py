"""Parts of pages that the program and its measurements write, so that they say what it does.

A page says where: the line ``*Here `make docs` writes, from the program: commands.*`` is replaced by Markdown
when the page is read, and tells whoever reads the page as it lies in the repository where the rest is. What
was measured is named by its figure: ``*Here `make docs` writes, from benchmarks/results: exactness.table.*``.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from sphinx.application import Sphinx

from from_program import (
    commands,
    elements,
    folders,
    formats,
    functions,
    keys,
    literature,
    measured,
    remedies,
    results,
    thesis,
)

PARTS: dict[str, Callable[[], str]] = {
    "commands": commands.commands,
    "exit statuses": commands.statuses,
    "element models": elements.models,
    "element laws": elements.laws,
    "outcomes": elements.outcomes,
    "model keys": keys.model,
    "dataset.toml keys": keys.dataset,
    "impacts.csv columns": keys.impacts,
    "recorder formats": formats.formats,
    "plan keys": keys.plan,
    "campaign keys": keys.campaign,
    "simulate keys": keys.simulation,
    "result files": results.files,
    "groups": results.groups,
    "variables": results.variables,
    "functions": functions.functions,
    "folders": folders.folders,
    "remedies": remedies.remedies,
    "published values": literature.published_values,
    "thesis exponents": thesis.exponents,
    "thesis audit": thesis.audit,
    "thesis recomputed": thesis.recomputed,
    "thesis causes": thesis.causes,
}
SOURCES: dict[str, Callable[[str], str]] = {
    "the program": lambda name: PARTS[name](),
    "benchmarks/results": measured.figure,
}
MARK = re.compile(rf"^\*Here `make docs` writes, from ({'|'.join(SOURCES)}): (.+)\.\*$", flags=re.MULTILINE)


def fill(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace every mark of a page; a part or a figure that there is not raises a KeyError."""
    source[0] = MARK.sub(lambda mark: SOURCES[mark[1]](mark[2]), source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Fill pages as they are read."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
