"""Messages longer than a terminal's line are wrapped, as a terminal wraps them; tables and code are not."""

from __future__ import annotations

import html
import re
from typing import Any

from sphinx.application import Sphinx

# As wide as the tables that the manual's commands print: see WIDTH in tests/docs/pages.py.
WIDTH = 96
_PRE = re.compile(
    r'(<div class="highlight-(?:console|text) notranslate"><div class="highlight"><pre>)(.*?)(</pre>)',
    re.DOTALL,
)
_OUTPUT = re.compile(r'(<span class="go">)?([^<]*)(</span>)?')


def wrapped(block: re.Match[str]) -> str:
    """A block with its long lines marked."""
    lines = block[2].split("\n")
    return block[1] + "\n".join(map(_marked, lines)) + block[3]


def _marked(line: str) -> str:
    inner = line.removeprefix("<span></span>")
    if len(html.unescape(re.sub("<.*?>", "", inner))) <= WIDTH or not _OUTPUT.fullmatch(inner):
        return line
    return f'<span class="long-line">{line}</span>'


def mark(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
    """Mark the long lines of a page's outputs."""
    if "body" in context:
        context["body"] = _PRE.sub(wrapped, context["body"])


def setup(app: Sphinx) -> dict[str, bool]:
    """Mark lines when pages are written; manual.css wraps them."""
    app.connect("html-page-context", mark)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
