"""The page of a fit in a browser: impacts, sides and keys, without a script, on a narrow screen, in print."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest

from bayestissue.reports.pages.fit import trace_predictions
from bayestissue.reports.pages.page import worded
from make_fit_run import fit_run
from page_reader import unpacked

pytestmark = pytest.mark.slow

browser = pytest.importorskip(
    "browser", reason="drives a browser by websocket-client, which is not installed"
)
needs_browser = pytest.mark.skipif(browser.CHROMIUM is None, reason="no Chromium is installed")


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    return fit_run(two_sides=True).report(tmp_path_factory.mktemp("driven") / "page.html")


@pytest.fixture(scope="module")
def run():
    return fit_run(two_sides=True)


@pytest.fixture(scope="module")
def tab():
    with browser.Browser() as opened:
        yield opened


CHOSEN = "document.querySelector('#impact').value"
DRAWN = (
    "document.querySelectorAll('#explorer .drawing svg.marks').length === 2 "
    "&& !document.querySelector('#impact').disabled"
)
CHARTS = "[...document.querySelectorAll('.chart')]"
EACH_IS_DRAWN = ".every(chart => chart.querySelector('svg.marks, canvas'))"


def test_what_is_carried_of_a_recording_is_it_to_half_a_step(run) -> None:
    table = run.impacts_table
    data = unpacked(trace_predictions.packed_impacts(run, table))
    (length,) = struct.unpack("<I", data[:4])
    header = json.loads(data[4 : 4 + length])
    low, high = np.frombuffer(data[4 + length :], np.uint8).reshape(2, -1).astype(int)
    added = low + 256 * high
    numbers = np.cumsum((added >> 1) * np.where(added % 2, -1, 1) - added % 2)
    assert header["impacts"]["impact"] == run.impacts
    assert header["factors"] == ["side", "person", "condition"]
    at = 0
    for place, trace in enumerate(header["traces"]):
        count = trace["samples"]
        step, finer = trace["steps"]
        part = numbers[at : at + count * 6].reshape(6, count) * np.array([[step], *[[finer]] * 5])
        at += count * 6
        rows = trace_predictions.trace_rows(run, place)
        # The median and what is added to it are each rounded.
        np.testing.assert_allclose(part[0], rows["median"], rtol=0, atol=0.5001 * step)
        np.testing.assert_allclose(part[0] + part[1], rows["recorded"], rtol=0, atol=0.5001 * (step + finer))
        time = trace["first"] + trace["interval"] * np.arange(count)
        np.testing.assert_allclose(time, rows["time_ms"], rtol=1e-9, atol=1e-9)
    assert at == numbers.size


def test_where_recordings_are_too_many_some_are_carried_and_the_page_says_so(run, monkeypatch) -> None:
    assert worded("fit", "carried", run) == ""
    monkeypatch.setattr(trace_predictions, "MOST_VALUES", 3 * 22 * 6)
    assert len(trace_predictions.carried(run)) == 3
    assert "Recordings of 3 of 12 impacts" in worded("fit", "carried", run)


@needs_browser
def test_a_page_wide_and_narrow_is_drawn_and_nothing_is_cut(tab, page) -> None:
    tab.read(page)


@needs_browser
def test_a_click_on_a_point_shows_that_impact_and_its_address_is_kept(tab, page) -> None:
    tab.open(page)
    tab.until(DRAWN)
    tab.js("document.querySelector('#explorer').scrollIntoView({ behavior: 'instant' })")
    # A point that no other lies on, and its impact.
    x, y, impact = tab.js(
        """[...document.querySelectorAll('[data-name=K-over-C] .mark-symbol path')].map(path => {
          const box = path.getBoundingClientRect(), at = [box.x + box.width / 2, box.y + box.height / 2];
          return document.elementFromPoint(...at) === path ? [...at, path.__data__.datum.impact] : null;
        }).find(one => one && one[2] !== document.querySelector('#impact').value)"""
    )
    before = tab.js("document.querySelector('#facts').textContent")
    tab.click(x, y)
    tab.until(f"{CHOSEN} === {impact!r}")
    assert tab.js("document.querySelector('#facts').textContent") != before
    assert "stiffness K" in tab.js("document.querySelector('#facts').textContent")
    address = tab.js("location.hash")
    assert impact in address
    # The address opens the same impact.
    tab.open(page, hash=address)
    tab.until(f"!document.querySelector('#impact').disabled && {CHOSEN} === {impact!r}")
    assert tab.errors == []
    assert all(url.startswith(("file:", "blob:", "data:")) for url in tab.requests)


@needs_browser
def test_keys_alone_go_from_impact_to_impact(tab, page) -> None:
    tab.open(page)
    tab.until(DRAWN)
    first = tab.js(CHOSEN)
    tab.tab_to("document.activeElement.matches('[data-name=K-over-C] .drawing')")
    tab.key("ArrowRight")
    tab.until(f"{CHOSEN} !== {first!r}")
    tab.key("ArrowLeft")
    tab.until(f"{CHOSEN} === {first!r}")
    assert tab.js("document.activeElement.getAttribute('aria-label')").startswith(
        "stiffness K of each impact"
    )


@needs_browser
def test_without_a_script_words_and_tables_stand(tab, page) -> None:
    tab.open(page, scripts=False)
    assert tab.js("document.querySelectorAll('.drawing svg').length") == 0
    text = tab.js("document.body.innerText")
    assert "What are K and C, and what differs by side?" in text
    assert "need JavaScript" in text
    assert tab.js("document.querySelectorAll('table').length") > 5


PICTURES = "[...document.querySelectorAll('.pictures figure svg.marks')]"


@needs_browser
def test_in_print_every_part_is_open_and_every_figure_drawn(tab, page) -> None:
    tab.open(page)
    # Those in closed parts too: nothing can be drawn while a page is being printed.
    tab.until(f"{CHARTS}{EACH_IS_DRAWN}")
    # Of both K and C, of which the screen shows one.
    shown = f"{PICTURES}.filter(one => one.getClientRects().length)"
    assert tab.js(f"{shown}.length") == 2
    opened = "document.querySelector('#diagnostics details').open"
    tab.js(f"addEventListener('beforeprint', () => {{ window.seen = {opened}; }})")
    assert tab.pdf().startswith(b"%PDF")
    assert tab.js("window.seen") is True
    tab.call("Emulation.setEmulatedMedia", media="print")
    assert tab.js(f"{shown}.length") == 4
    tab.call("Emulation.setEmulatedMedia", media="")
    # Afterwards the page is as it was.
    assert tab.js("document.querySelector('#diagnostics details').open") is False


@needs_browser
def test_a_figure_and_its_numbers_are_saved(tab, page, run, tmp_path) -> None:
    tab.open(page)
    tab.until(DRAWN)
    files = {}
    for kind in ("SVG", "PNG", "CSV"):
        files[kind] = tab.figure_saved(tmp_path / kind, "K-over-C", kind)
        (saved,) = (tmp_path / kind).iterdir()
        assert saved.name == f"K-over-C.{kind.lower()}"
    svg = ET.fromstring(files["SVG"])  # noqa: S314 - the page's own
    words = {"".join(element.itertext()) for element in svg.iter("{http://www.w3.org/2000/svg}text")}
    assert {"stiffness K (N/m)", "damping C (N s/m)"} <= words
    assert files["PNG"].startswith(b"\x89PNG")
    table = pd.read_csv(io.BytesIO(files["CSV"]), encoding="utf-8-sig").set_index("impact").loc[run.impacts]
    expected = run.of_impacts("K")["median"]
    # A page's numbers have four digits.
    np.testing.assert_allclose(table["K_N_per_m"], expected, rtol=5e-4)
