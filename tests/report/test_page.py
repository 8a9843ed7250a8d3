from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import jinja2
import matplotlib as mpl
import pytest

from bayestissue.remedies import entries
from bayestissue.report.page import again, figure, prose, render_page
from bayestissue.report.style import new_figure, style

pytestmark = pytest.mark.usefixtures("drawn")


def line(label: str = "x (m)"):
    with style():
        fig, axes = new_figure()
        axes.plot([0.0, 1.0], [0.0, 2.0], marker="o")
        axes.set_xlabel(label)
    return fig


def test_values_are_escaped():
    page = render_page("base.html", title="<script>alert(1)</script>")
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page


def test_a_name_the_template_wants_and_does_not_get_is_an_error():
    with pytest.raises(jinja2.UndefinedError):
        render_page("base.html")


def test_the_contents_link_to_anchors():
    assert '<a href="#audit">The audit</a>' in render_page(
        "base.html", title="t", contents=[("audit", "The audit")]
    )


def test_a_figure_is_well_formed_and_says_what_it_shows():
    svg = figure(line(), 'K < 3 & "C"')
    root = ET.fromstring(svg)  # noqa: S314 - our own figure
    assert root.attrib["aria-label"] == 'K < 3 & "C"'
    assert "x (m)" in "".join(root.itertext())


def test_a_figure_brings_no_rules_for_the_rest_of_the_page():
    assert "<style" not in figure(line(), "a line")


def test_two_figures_share_no_names_and_keep_their_own_references():
    first, second = figure(line("x (m)"), "one"), figure(line("t (s)"), "two")
    names = [set(re.findall(r'\bid="([^"]+)"', svg)) for svg in (first, second)]
    assert not names[0] & names[1]
    used = set(re.findall(r'(?:url\(#|href="#)([^")]+)', first))
    assert used
    assert used <= names[0]


def test_the_same_figure_is_the_same_bytes():
    assert figure(line(), "a line") == figure(line(), "a line")


def test_a_figure_of_many_points_is_a_picture():
    image = figure(line(), "a line", raster=True)
    assert image.startswith("<img")
    assert "data:image/png;base64," in image


def test_the_look_leaves_no_trace():
    before = dict(mpl.rcParams)
    line()
    assert dict(mpl.rcParams) == before


def test_a_page_carries_the_entries_of_its_warnings() -> None:
    html = render_page("base.html", title="A page", codes=["clipped", "hum", "clipped"])
    assert html.count('<details id="explain-clipped">') == 1
    text = " ".join(html.split())
    assert all(str(prose(words)) in text for code in ("clipped", "hum") for _, words in entries()[code].parts)
    assert 'id="warnings"' not in render_page("base.html", title="A page")
    assert prose("<b> `a < b`") == "&lt;b&gt; <code>a &lt; b</code>"


def test_a_figure_is_drawn_again_and_held_once() -> None:
    shown = figure(line(), "A line")
    second = again(shown)
    own = re.match(r'<svg id="([^"]+)"', shown)[1]
    assert f'<use href="#{own}">' in second
    assert ' id="' not in second
    assert len(second) < 400
    picture = figure(line(), "A line", raster=True)
    assert again(picture) == picture


def test_a_page_reads_without_its_script_and_prints_its_summary_first() -> None:
    """Buttons that sort come from the script alone; in print the summary has the first page to itself."""
    html = render_page("base.html", title="A page")
    static = html[: html.index("<script>")]
    assert "<button" not in static
    printed = html[html.index("@media print") : html.index("</style>")]
    assert ".summary { display: block" in printed
    assert "main { break-before: page; }" in printed
    assert ".summary { display: none; }" in html
