"""The first screen of each kind of page in a browser, at three widths."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from test_fit_page import with_diagnostics

from bayestissue.inference.checking.model_form import stated
from bayestissue.reports.pages import write_report
from make_fit_run import make_fit_run
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


def not_described(folder: Path) -> Path:
    form = stated({"score": 9.0, "undescribed": True, "discrepancy": 0.3})
    return write_report(with_diagnostics(folder, model_form=form))


ONE_MASS = {"exponent": None, "mass_varies": False, "quantity": "displacement", "truth": False}
BESIDE = {"discrepancy": True, "likelihood": "impact", "own_depth": 0.3, "two_sides": True}


@pytest.mark.parametrize(
    ("options", "figures", "page"),
    [
        ({}, 2, write_report),
        ({"two_sides": True}, 2, write_report),
        (BESIDE, 2, write_report),
        (ONE_MASS, 2, write_report),
        ({"passed": False}, 2, write_report),
        ({}, 0, not_described),
    ],
    ids=["masses", "sides", "beside a discrepancy", "one mass", "failed", "not described"],
)
def test_a_fit_is_answered_without_scrolling(
    options: dict, figures: int, page: Callable[[Path], Path], tab, tmp_path: Path
) -> None:
    tab.see_first(page(make_fit_run(tmp_path / "run", **options)), figures)


def test_so_are_the_published_values(tab, tmp_path: Path) -> None:
    tab.see_first(write_report(make_published_run(tmp_path / "run")), 1)
