from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import jinja2
import numpy as np
import pandas as pd
import pytest

from bayestissue.base.remedies import entries
from bayestissue.reports.figures.study import points
from bayestissue.reports.figures.theme import Figure, number
from bayestissue.reports.pages.page import MOST_NUMBERS, again, drawn, prose, render_page
from page_reader import figures


def line(title: str = "x (m)", samples: int = 2) -> Figure:
    rows = pd.DataFrame({"x": np.arange(samples) * 1.0, "y": np.arange(samples) * 2.0, "kind": "a"})
    return points(rows, number("x", title), number("y", "y (m)"), 'K < 3 & "C"')


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


def test_a_figure_says_what_it_shows_and_has_its_numbers():
    shown = drawn(line(), "a-line")
    root = ET.fromstring(shown)  # noqa: S314 - our own figure
    assert root.find("div[@role='img']").attrib["aria-label"] == 'K < 3 & "C"'
    assert root.attrib["data-name"] == "a-line"
    assert [cell.text for cell in root.iter("td")] == ["0", "0", "a", "1.000", "2.000", "a"]
    (chart,) = figures(shown)
    assert '"title":"x (m)"' in chart


def test_of_many_numbers_the_first_stand_under_a_figure():
    shown = drawn(line(samples=MOST_NUMBERS + 5))
    assert f"The first {MOST_NUMBERS} of {MOST_NUMBERS + 5} rows of the numbers" in shown
    assert shown.count("<tr>") == MOST_NUMBERS + 1


def test_the_same_figure_is_the_same_bytes():
    assert drawn(line()) == drawn(line())


def test_two_figures_share_no_names():
    first, second = drawn(line("x (m)")), drawn(line("t (s)"))
    names = [set(re.findall(r'\bid="([^"]+)"', figure)) for figure in (first, second)]
    assert not names[0] & names[1]


def test_a_page_carries_the_entries_of_its_warnings() -> None:
    html = render_page("base.html", title="A page", codes=["clipped", "hum", "clipped"])
    assert html.count('<details id="explain-clipped">') == 1
    text = " ".join(html.split())
    assert all(str(prose(words)) in text for code in ("clipped", "hum") for _, words in entries()[code].parts)
    assert 'id="warnings"' not in render_page("base.html", title="A page")
    assert prose("<b> `a < b`") == "&lt;b&gt; <code>a &lt; b</code>"


def test_a_figure_is_drawn_again_and_held_once() -> None:
    (identifier,) = re.findall(r'<div class="chart" id="([^"]+)"', drawn(line()))
    assert again(line()) == f'<div class="again" data-of="{identifier}"></div>'


def test_a_page_reads_without_its_script_and_prints_its_summary_first() -> None:
    """Buttons that sort come from the script alone; in print the summary has the first page to itself."""
    html = render_page("base.html", title="A page")
    static = html[: html.index("<script>")]
    assert "<button" not in static
    printed = html[html.index("@media print") : html.index("</style>")]
    assert ".summary { display: block" in printed
    assert "main { break-before: page; }" in printed
    assert ".summary { display: none; }" in html
