"""The first screen of each kind of page in a browser, at three widths."""

from __future__ import annotations

from pathlib import Path

import pytest
from changed_fits import undescribed

from bayestissue.reports.pages import write_report
from make_fit_run import fit_run
from make_published_run import make_published_run

browser = pytest.importorskip(
    "browser", reason="drives a browser by websocket-client, which is not installed"
)
pytestmark = [
    pytest.mark.skipif(browser.CHROMIUM is None, reason="no Chromium is installed"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def tab():
    with browser.Browser() as opened:
        yield opened


MADE = {
    "masses": (2, {}),
    "sides": (2, {"two_sides": True}),
    "beside a discrepancy": (2, {"discrepancy": True, "own_depth": 0.3, "two_sides": True}),
    "one mass": (2, {"exponent": None, "mass_varies": False, "passed": False}),
    "not described": (0, {}),
}


@pytest.mark.parametrize("name", MADE)
def test_a_fit_is_answered_without_scrolling(name: str, tab, tmp_path: Path) -> None:
    figures, options = MADE[name]
    run = fit_run(**options)
    page = (run if figures else undescribed(run)).report(tmp_path / "page.html")
    tab.see_first(page, figures)


def test_so_are_the_published_values(tab, tmp_path: Path) -> None:
    tab.see_first(write_report(make_published_run(tmp_path / "run")), 1)
