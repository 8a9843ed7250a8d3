"""Every page in a browser, wide and narrow; that of a fit has more tests, that of a plan is by the plans'."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from test_estimates_page import make_estimates_run

import bayestissue as bt
from bayestissue.recordings.dataset import read_dataset, write_dataset
from bayestissue.recordings.signal import displacements
from bayestissue.reports.pages import write_report
from bayestissue.reports.pages.recordings_pages import init_page
from bayestissue.studies.checking import check
from dataset_bench import SETTINGS, tables
from make_fit_run import make_scored_run
from make_published_run import make_published_run

browser = pytest.importorskip(
    "browser", reason="drives a browser by websocket-client, which is not installed"
)
pytestmark = [
    pytest.mark.skipif(browser.CHROMIUM is None, reason="no Chromium is installed"),
    pytest.mark.slow,
]


def dataset(folder: Path) -> Path:
    impacts, traces = tables()
    write_dataset(folder / "data", settings=SETTINGS, impacts=impacts, traces=traces)
    return folder / "data"


def estimates(folder: Path) -> Path:
    return write_report(make_estimates_run(folder))


def published(folder: Path) -> Path:
    return write_report(make_published_run(folder / "run"))


def comparison(folder: Path) -> Path:
    runs = [make_scored_run(folder / f"{worse}", worse=worse) for worse in (0.0, 2.0)]
    bt.compare(*runs).report(folder / "out")
    return folder / "out" / "report.html"


def recordings(folder: Path) -> Path:
    page = folder / "check.html"
    page.write_text(check(dataset(folder)).page())
    return page


def started(folder: Path) -> Path:
    page = folder / "init.html"
    data = read_dataset(dataset(folder))
    page.write_text(init_page(data, displacements(data), understood=[], left_out=[], notes=[]))
    return page


@pytest.fixture(scope="module")
def tab():
    with browser.Browser() as opened:
        yield opened


@pytest.mark.parametrize("page", [estimates, published, comparison, recordings, started])
def test_every_figure_is_drawn_and_nothing_is_cut(page: Callable[[Path], Path], tab, tmp_path: Path) -> None:
    tab.read(page(tmp_path))
