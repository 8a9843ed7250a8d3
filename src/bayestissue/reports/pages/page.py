"""Pages that need nothing but themselves: templates, and figures as part of the text."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import jinja2
from markupsafe import Markup, escape

from bayestissue.base.declarations import general
from bayestissue.base.outline import counted, numbers_in_short
from bayestissue.base.remedies import Code, entries
from bayestissue.base.words import PLAIN, Words
from bayestissue.reports.figures.browser import figure_json, library, library_script, packed
from bayestissue.reports.figures.theme import Figure
from bayestissue.reports.pages import page_tables
from bayestissue.reports.pages.wording import (
    half_width,
    likelihood_words,
    listed,
    number,
    percent,
    probability,
    significant,
    with_error,
)

_BEGINS, _ENDS = '<meta charset="utf-8">', "</footer>"
# A figure where a template has drawn it; `render_page` takes all out and packs them as one.
_FIGURE = re.compile(r'<script type="application/json" data-of="(chart-\w+)">(.*?)</script>', re.DOTALL)
# A page's own script, and the figures' library that this script unpacks; a style runs no script.
_POLICY = (
    "default-src 'none'; script-src 'sha256-{}' blob:; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)


def render_page(
    template: str, *, codes: Iterable[Code] = (), served: bool = False, nouns: Words = PLAIN, **context: Any
) -> str:
    """The HTML of ``template`` (a name in `report/templates`), filled from ``context``.

    Values are escaped unless they are `Markup`; a name that the template wants and ``context`` lacks is
    an error. Templates extend ``base.html``, which takes ``title`` and, if wanted, ``subtitle`` and
    ``contents``, a sequence of pairs (anchor, words) for the table of contents. ``codes`` are of the warnings
    that the page holds: their entries stand at its foot, where links of the macro ``explained`` lead.
    ``nouns`` are the dataset's own, which then stand in all prose and figures.
    A page that is ``served`` has its style and scripts from its server: see `assets`.
    """
    codes = list(dict.fromkeys(codes))
    html = _environment().get_template(template).render(codes=codes, served=served, nouns=nouns, **context)
    figures = dict(_FIGURE.findall(html))
    html = nouns.page(_FIGURE.sub("", html))
    if figures:
        content = ",".join(f'"{name}":{figure}' for name, figure in figures.items())
        html = html.replace(_ENDS, f"{_ENDS}\n{_carried('figures-data', packed(f'{{{content}}}'.encode()))}")
    if served:
        return html
    # The page's own script is the last: whatever else calls itself one is refused by the browser.
    body, begin, end = html.rpartition("<script>")
    script = end.partition("</script>")[0]
    if figures:
        body += f"{_carried('library', library())}\n"
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY.format(digest)}">'
    return (body + begin + end).replace(_BEGINS, f"{_BEGINS}\n{policy}", 1)


def assets(*scripts: str) -> dict[str, str]:
    """What pages that are served refer to, by name: their style, their scripts as one, the figures' library.

    ``scripts`` are names in `report/templates` behind that of every page.
    """
    return {
        "page.css": script("style.css"),
        "page.js": "\n".join(map(script, ("page.js", *scripts))),
        "library.js": library_script(),
    }


def _carried(name: str, text: str) -> str:
    """What is `packed`, as an element that runs nothing."""
    return f'<script type="text/plain" id="{name}">{text}</script>'


def drawn(one: Figure, name: str = "", nouns: Words = PLAIN) -> Markup:
    """A figure that the browser draws, and its numbers when they are wanted; a script calls it by ``name``.

    Without a script its words stand alone.
    """
    chart: Markup = part("figure.html").chart(*_chart(one, nouns), one.words, name)
    return chart


def _chart(one: Figure, nouns: Words) -> tuple[str, Markup]:
    """What the page calls a figure, and how it holds it."""
    figure = figure_json(nouns.chart(one.specification()))
    return f"chart-{hashlib.sha256(figure.encode()).hexdigest()[:8]}", Markup(figure)  # noqa: S704 - no tags


def again(one: Figure, nouns: Words = PLAIN) -> Markup:
    """A figure once more on the same page, which holds it once and draws it first."""
    return Markup('<div class="again" data-of="{}"></div>').format(_chart(one, nouns)[0])


def prose(text: str) -> Markup:
    """Text of an entry of `bayestissue.base.remedies`: what stands between ` is code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))  # noqa: S704 - escaped before


def part(template: str) -> Any:
    """The macros of a template, which make parts of a page."""
    return _environment().get_template(template).module


def written(template: str, macro: str, *values: Any) -> list[str]:
    """The paragraphs that a macro of ``words/TEMPLATE.jinja`` writes, which a blank line tells apart."""
    paragraphs = re.split(r"\n\s*\n", str(getattr(part(f"words/{template}.jinja"), macro)(*values)))
    return [re.sub(r" *\n *", " ", text.strip()) for text in paragraphs if text.strip()]


def worded(template: str, macro: str, *values: Any) -> str:
    """The same as one text."""
    return " ".join(written(template, macro, *values))


def _module(name: str) -> ModuleType:
    """A module of `bayestissue.reports`, such as ``pages.fit.answers``."""
    return import_module(f"bayestissue.reports.{name}")


def script(name: str) -> Markup:
    """A script of `report/templates`, as it stands in a page."""
    return Markup(_environment().loader.get_source(_environment(), name)[0])  # type: ignore[union-attr] # noqa: S704


def _in_the_pages_nouns(draw: Callable[..., Markup]) -> Callable[..., Markup]:
    @jinja2.pass_context
    def filtered(page: jinja2.runtime.Context, *args: Any) -> Markup:
        return draw(*args, nouns=page.get("nouns", PLAIN))

    return filtered


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("bayestissue.reports.pages", "templates"),
        autoescape=jinja2.select_autoescape(["html"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # How sentences of a template write numbers and names.
    of_numbers = (
        general,
        half_width,
        likelihood_words,
        number,
        percent,
        probability,
        significant,
        with_error,
    )
    for words in (prose, counted, listed, numbers_in_short, *of_numbers):
        environment.filters[words.__name__] = words
    for draw in (again, drawn):
        environment.filters[draw.__name__] = _in_the_pages_nouns(draw)
    # A template asks the modules that it names for numbers, tables and figures.
    named = {"module": _module, "worded": worded, "written": written}
    environment.globals |= named | {"script": script, "tables": page_tables, "remedies": entries()}
    return environment
