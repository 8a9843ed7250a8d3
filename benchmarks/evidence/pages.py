"""Figures in the README and the manual: put between their marks, and looked for where they are typed.

A figure within a sentence is written `<!-- evidence: NAME -->text<!-- end -->`; a paragraph has the marks on
lines of its own. What stands between them is written by `fill`. Tables of the evidence page are written when
the manual is built, by `docs/_extensions/from_program`.
"""

from __future__ import annotations

import ast
import json
import re
import textwrap
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from evidence.figures import figures
from evidence.registry import ROOT, SHOWN, content
from evidence.status import state_of
from evidence.summary import figure
from evidence.texts import Figure, coverage, raw

MARKED = re.compile(
    r"(?P<indent>^[ ]*)?<!-- evidence: (?P<name>\S+) -->(?P<text>.*?)<!-- end -->", re.M | re.S
)
FENCED = re.compile(r"^ *(```+|~~~+).*?^ *\1 *$", re.M | re.S)

# A number with the unit of a share, a time or a memory, or so many of so many.
_NUMBER = re.compile(
    r"\d[\d.,]* ?(?:%|µs\b|ms\b|s\b|seconds?\b|min\b|minutes?\b|h\b|hours?\b|[GM]iB\b|times\b)|\d[\d,]* of \d"
)
_CLAIM = re.compile(
    r"\b(?:held|hold the truth|measured|took|takes|as long as|effective samples|flagged|found in|coverage|"
    r"alarms?|in simulations|simulated (?:campaigns|impacts|sets|people))\b"
    r"|\d times (?:faster|slower|fewer|less)",
    re.I,
)
# A level of probability that an interval is asked for is no measurement.
_LEVEL = re.compile(
    r"(?:\d[\d.]* ?% (?:and|or) )?\d[\d.]* ?% (?:credible |equal-tailed |posterior |predictive )?"
    r"(?:interval|limit|level|band)"
    r"|(?:interval|limit|level|band)s? of \d[\d.]* ?%|\(\d[\d.]* ?%\)"
)


def pages() -> list[Path]:
    """The README and the pages of the manual that are written by hand."""
    manual = (path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)
    return [ROOT / "README.md", *sorted(manual)]


def sources() -> list[Path]:
    """All that people read and that may state a figure: the pages, notebooks, and the words of reports."""
    notebooks = (path for path in (ROOT / "docs").rglob("*.ipynb") if "_build" not in path.parts)
    report = ROOT / "src" / "bayestissue" / "reports" / "pages"
    read = [path for end in ("html", "py", "toml") for path in sorted(report.rglob(f"*.{end}"))]
    return [*pages(), *sorted(notebooks), *read]


def prose(path: Path) -> str:
    """What of a source people read: of a notebook the text between its code, of a program its strings."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        cells = (cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown")
        return "\n\n".join("".join(cell["source"]) for cell in cells)
    if path.suffix == ".py":
        strings = (node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant))
        return "\n\n".join(string for string in strings if isinstance(string, str))
    return re.sub(r"<[^!>]+>", " ", text) if path.suffix == ".html" else text


def fill() -> list[str]:
    """Write every figure into every page, and the coverage that a fit's page shows; what was changed."""
    figures.cache_clear()
    state_of.cache_clear()
    changed = []
    for path in pages():
        if (text := filled_page(path)) != path.read_text(encoding="utf-8"):
            path.write_text(text, encoding="utf-8")
            changed.append(path.relative_to(ROOT).as_posix())
    if coverage_shown() != SHOWN.read_text(encoding="utf-8"):
        SHOWN.write_text(coverage_shown(), encoding="utf-8")
        changed.append(SHOWN.relative_to(ROOT).as_posix())
    return changed


def filled_page(path: Path) -> str:
    """A page's text with its figures as the result files have them; the README has measured ones alone."""
    return filled(path.read_text(encoding="utf-8"), measured=path == ROOT / "README.md")


def filled(text: str, *, measured: bool = False) -> str:
    """A text with its figures, none in place of those that are not ``measured`` if they alone are wanted."""
    with_text = partial(_with_text, measured=measured)
    return "".join(part if fenced else MARKED.sub(with_text, part) for part, fenced in _parts(text))


def _with_text(mark: re.Match[str], *, measured: bool) -> str:
    name, begin = mark["name"], f"{mark['indent'] or ''}<!-- evidence: {mark['name']} -->"
    content = figure(name)
    if measured and not content.measured:
        return f"{begin}<!-- end -->"
    if "\n" in mark["text"] or content.block:
        indent = mark["indent"] or ""
        text = textwrap.indent(paragraph(content), indent)
        return f"{begin}\n\n{text}\n\n{indent}<!-- end -->"
    return f"{begin}{content.text}<!-- end -->"


def paragraph(made: Figure) -> str:
    """A figure on lines of its own: a table as it is, a part of a sentence as a sentence."""
    return made.text if made.block else f"{made.text[0].upper()}{made.text[1:]}."


def coverage_shown() -> str:
    """The table of coverage that comes with the program, for the page of a fit; as it is until measured."""
    columns = ["likelihood", "quantity", "level", "held", "impacts"]
    if "coverage_fit.table" not in figures():
        return SHOWN.read_text(encoding="utf-8")
    lines = coverage(raw("coverage_fit"), ["each", "quantity"])
    return lines.rename(columns={"each": "likelihood"})[columns].to_csv(index=False)


def misplaced(text: str) -> Iterator[str]:
    """Marks of figures within a sentence that begin a line, where Markdown shows the line as it stands."""
    for part, fenced in _parts(text):
        for found in MARKED.finditer(part) if not fenced else ():
            if found["indent"] is not None and "\n" not in found["text"] and not figure(found["name"]).block:
                yield found["name"]


def typed(page: str, text: str) -> Iterator[str]:
    """Sentences that state a measured number outside the marks, as far as words and units can tell.

    Left out are code, links, and what evidence.toml lists under ``not_measured``.
    """
    allowed = [each["words"] for each in content().get("not_measured", []) if each["page"] == page]
    prose = " ".join(MARKED.sub(" ", part) if not fenced else "\n\n" for part, fenced in _parts(text))
    prose = re.sub(r"^(?: {4,}|\t).*$", "", prose, flags=re.M)
    prose = re.sub(r"`[^`]*`|\]\([^)]*\)", " ", prose)
    for block in re.split(r"\n\s*\n|^\s*[-*|#]", prose, flags=re.M):
        for sentence in re.split(r"(?<=[.!?;])\s+", " ".join(block.split())):
            told = _LEVEL.sub(" ", sentence)
            if (
                _NUMBER.search(told)
                and _CLAIM.search(told)
                and not any(words in sentence for words in allowed)
            ):
                yield sentence


def unlisted() -> Iterator[str]:
    """Entries of ``not_measured`` whose words are no longer on their page."""
    for each in content().get("not_measured", []):
        path = ROOT / each["page"]
        if not path.is_file() or each["words"] not in " ".join(path.read_text(encoding="utf-8").split()):
            yield f"{each['page']}: {each['words']}"


def _parts(text: str) -> Iterator[tuple[str, bool]]:
    """The text in pieces, and whether each is a fenced block."""
    at = 0
    for found in FENCED.finditer(text):
        yield text[at : found.start()], False
        yield found[0], True
        at = found.end()
    yield text[at:], False
