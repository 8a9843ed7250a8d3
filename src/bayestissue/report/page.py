"""Pages that need nothing but themselves: templates, and figures as part of the text."""

from __future__ import annotations

import base64
import gzip
import hashlib
import io
import re
from collections.abc import Iterable
from functools import cache
from typing import Any

import jinja2
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from bayestissue.figures.browser import library, packed_json
from bayestissue.figures.theme import Figure as Drawn
from bayestissue.remedies import Code, entries
from bayestissue.report.style import style
from bayestissue.report.tables import frame_table

_PIXELS_PER_INCH = 96


def render_page(template: str, *, codes: Iterable[Code] = (), served: bool = False, **context: Any) -> str:
    """The HTML of ``template`` (a name in `report/templates`), filled from ``context``.

    Values are escaped unless they are `Markup`; a name that the template wants and ``context`` lacks is
    an error. Templates extend ``base.html``, which takes ``title`` and, if wanted, ``subtitle`` and
    ``contents``, a sequence of pairs (anchor, words) for the table of contents. ``codes`` are of the warnings
    that the page holds: their entries stand at its foot, where links of the macro ``explained`` lead.
    A page that is ``served`` has its style and scripts from its server: see `assets`.
    """
    codes = list(dict.fromkeys(codes))
    html = _environment().get_template(template).render(codes=codes, served=served, **context)
    if served or 'class="packed"' not in html:
        return html
    carried = f'<script type="text/plain" id="library">{library()}</script>'
    return html.replace("<script>", f"{carried}\n<script>", 1)


def assets(*scripts: str) -> dict[str, str]:
    """What pages that are served refer to, by name: their style, their scripts as one, the figures' library.

    ``scripts`` are names in `report/templates` behind that of every page.
    """
    return {
        "page.css": script("style.css"),
        "page.js": "\n".join(map(script, ("page.js", *scripts))),
        "library.js": gzip.decompress(base64.b64decode(library())).decode(),
    }


# As many rows stand in the page behind a figure; its download has all.
MOST_NUMBERS = 100


def drawn(one: Drawn | Markup, name: str = "") -> Markup:
    """A figure that the browser draws, with its numbers as a table; ``name`` is what a script calls it by.

    Without a script the table stands alone. What is drawn already stays as it is.
    """
    if isinstance(one, Markup):
        return one
    packed = packed_json(one.specification())
    numbers = frame_table(one.data[:MOST_NUMBERS])
    chart: Markup = part("figure.html").chart(
        _chart_id(packed), one.words, packed, name, numbers, len(one.data)
    )
    return chart


def _chart_id(packed: str) -> str:
    return f"chart-{hashlib.sha256(packed.encode()).hexdigest()[:8]}"


def figure(fig: Figure, alt: str, *, raster: bool = False) -> Markup:
    """``fig`` as an element for a page: inline SVG, or a PNG when ``raster`` (many points).

    ``alt`` says in words what the figure shows, for those who can't see it. The figure keeps its own
    width where the page is wide enough and shrinks where it isn't.
    """
    width = round(fig.get_figwidth() * _PIXELS_PER_INCH)
    return _png(fig, alt, width) if raster else _svg(fig, alt, width)


def _png(fig: Figure, alt: str, width: int) -> Markup:
    buffer = io.BytesIO()
    with style():
        fig.savefig(buffer, format="png", dpi=160, metadata={"Software": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return Markup('<img class="plot" style="max-width:{}px" alt="{}" src="data:image/png;base64,{}">').format(
        width, alt, data
    )


def _svg(fig: Figure, alt: str, width: int) -> Markup:
    buffer = io.StringIO()
    with style():
        fig.savefig(
            buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    text = buffer.getvalue()
    view_box = re.search(r'viewBox="([^"]+)"', text)
    body = text[text.index(">", text.index("<svg")) + 1 : text.rindex("</svg>")]
    # Matplotlib's own style element would rule the whole page; style.css says the same for plots only.
    body = re.sub(r"<(metadata|style)\b.*?</\1>", "", body, flags=re.DOTALL)
    # Names are unique within a figure only, and one page holds many.
    identifier = "f" + hashlib.sha256(text.encode()).hexdigest()[:8]
    body = re.sub(r'\bid="', f'id="{identifier}-', body)
    body = re.sub(r'(url\(#|href="#)', rf"\1{identifier}-", body)
    return Markup(
        '<svg id="{own}" class="plot" style="max-width:{width}px" role="img" aria-label="{alt}" '
        'viewBox="{view_box}" xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
        "<title>{alt}</title>{body}</svg>"
    ).format(
        own=identifier,
        width=width,
        alt=alt,
        view_box=view_box[1] if view_box else "",
        body=Markup(body),  # noqa: S704 - matplotlib has escaped the text in it
    )


def again(shown: Drawn | Markup) -> Markup:
    """A figure once more on the same page, which holds it once and draws it first."""
    if not isinstance(shown, Markup):
        of = _chart_id(packed_json(shown.specification()))
        return Markup('<div class="again" data-of="{}"></div>').format(of)
    svg = re.match(r'<svg id="([^"]+)" class="plot" style="([^"]*)" .*?viewBox="([^"]*)"', shown)
    if svg is None:
        return shown
    identifier, size, view_box = svg.groups()
    return Markup(
        '<svg class="plot" style="{}" role="img" aria-label="The figure below" viewBox="{}">'
        '<use href="#{}"></use></svg>'
    ).format(size, view_box, identifier)


def prose(text: str) -> Markup:
    """Text of an entry of `bayestissue.remedies`: what stands between ` is code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))  # noqa: S704 - escaped before


def part(template: str) -> Any:
    """The macros of a template, which make parts of a page."""
    return _environment().get_template(template).module


def script(name: str) -> Markup:
    """A script of `report/templates`, as it stands in a page."""
    return Markup(_environment().loader.get_source(_environment(), name)[0])  # type: ignore[union-attr] # noqa: S704


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("bayestissue.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["prose"] = prose
    environment.filters["again"] = again
    environment.filters["drawn"] = drawn
    environment.globals["script"] = script
    environment.globals["remedies"] = entries()
    return environment
