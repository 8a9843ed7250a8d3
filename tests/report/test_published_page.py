"""The page of the thesis's published values: of the run that is stored, and of changed ones."""

from __future__ import annotations

import pytest

from bayestissue.reports.pages import write_report
from cases import cases
from page_reader import first_screen, plain, require_whole


@pytest.fixture(scope="module")
def html(published_run_folder):
    return write_report(published_run_folder).read_text(encoding="utf-8")


def test_it_is_whole(html):
    require_whole(html)


@pytest.mark.parametrize(("part", "words"), cases(__file__, "says"))
def test_it_says(html, part, words):
    text = plain({"first": first_screen, "all": str}[part](html))
    wrong = [one for one in words if (one.removeprefix("not ") in text) == one.startswith("not ")]
    assert wrong == [], text[:4000]


def test_the_first_screen_begins_with_what_was_found_and_doubts_k_and_c_last(html):
    first = first_screen(html)
    order = (
        "K repeats the mass",
        'data-name="K-over-mass"',
        "What else the audit found",
        "Do not use these K",
    )
    places = [first.index(words) for words in (*order, "K = <b>17.3</b>")]
    assert places == sorted(places)
    assert html.count("K = <b>17.3</b>") == 1
    assert html.count('<tr class="disagrees"><td class="text">5.10') == 15
