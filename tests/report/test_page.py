from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import jinja2
import numpy as np
import pandas as pd
import pytest
from markupsafe import Markup

from bayestissue.base.remedies import entries
from bayestissue.reports.figures.browser import packed
from bayestissue.reports.figures.study_comparisons import points
from bayestissue.reports.figures.theme import Figure, number
from bayestissue.reports.pages.page import again, drawn, prose, render_page
from page_reader import figures, unpacked


def line(title: str = "x (m)", samples: int = 2) -> Figure:
    rows = pd.DataFrame({"x": np.arange(samples) * 1.0, "y": np.arange(samples) * 2.0, "kind": "a"})
    return points(rows, number("x", title), number("y", "y (m)"), 'K < 3 & "C"')


def test_values_are_escaped_and_one_that_lacks_is_an_error():
    page = render_page("base.html", title="<script>alert(1)</script>")
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page
    with pytest.raises(jinja2.UndefinedError):
        render_page("base.html")


def test_a_figure_says_what_it_shows_and_has_its_numbers():
    shown = drawn(line(), "a-line")
    root = ET.fromstring(shown)  # noqa: S314 - our own figure
    assert root.find("div[@role='img']").attrib["aria-label"] == 'K < 3 & "C"'
    assert root.attrib["data-name"] == "a-line"
    chart = root.find("script").text
    assert '"title":"x (m)"' in chart
    assert '{"x":[0.0,1.0],"y":[0.0,2.0],"kind":["a","a"]}' in chart


def test_a_page_carries_its_figures_as_one_and_the_library_once():
    shown = [drawn(line(title)) for title in ("x (m)", "t (s)", "x (m)")]
    html = render_page("base.html", title="A page", codes=[], subtitle=Markup("").join(shown))
    assert ['"title":"t (s)"' in one for one in figures(html)] == [False, True]
    assert html.count('id="library"') == html.count('id="figures-data"') == 1
    assert 'type="application/json"' not in html


def test_what_is_packed_comes_back_and_holds_no_mark_of_html():
    content = bytes(range(256)) * 40
    for length in range(5):
        text = packed(content[length:])
        assert unpacked(text) == content[length:]
        assert not set(text) & set("<>&'\"")


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
