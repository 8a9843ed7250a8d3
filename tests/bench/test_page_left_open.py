"""A page of `watch` that is left open for a thousand drops: what browser and server hold stays flat.

The drops are fed into the watch's own list, since a thousand estimates would be measured besides; traces and
their fits are those of recordings that it took. ``--log-cli-level=info`` shows the figures.
"""

from __future__ import annotations

import gc
import logging
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from opened import address, served
from written_drops import drop, plan_of_drops, write

from bayestissue.studies.bench.drops import LIST
from bayestissue.studies.bench.views import WatchView
from bayestissue.studies.bench.watching import Watch

browser = pytest.importorskip(
    "browser", reason="drives a browser by websocket-client, which is not installed"
)
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(browser.CHROMIUM is None, reason="no Chromium is installed"),
]
EVENTS, WARM_UP, APART, PAGES = 1000, 250, 25, 3
# Of an estimated slope, in its standard errors.
SURE = 4.0


class Slope(NamedTuple):
    """A growth a step, with its standard error by the scatter about the line."""

    value: float
    error: float


def slope(at: np.ndarray, values: np.ndarray) -> Slope:
    (b, _), covariance = np.polyfit(at, values, 1, cov=True)
    return Slope(float(b), float(np.sqrt(covariance[0, 0])))


def heap(tab: browser.Browser) -> float:
    """Bytes that the page's scripts and what they refer to hold after a collection."""
    for _ in range(2):
        tab.call("HeapProfiler.collectGarbage")
    return float(tab.call("Runtime.getHeapUsage")["usedSize"])


@pytest.fixture
def traced() -> Iterator[None]:
    """Every block that Python hands out is counted, as long as a test runs."""
    tracemalloc.start()
    yield
    tracemalloc.stop()


def held_here() -> float:
    """Bytes that this process, in which the server runs, holds after a collection.

    Counted block by block: resident memory moves in steps of an arena, by what other lists of the same length
    as the server's leave free, and has no standard error.
    """
    gc.collect()
    return float(tracemalloc.get_traced_memory()[0])


def until_shown(tab: browser.Browser, impact: str) -> None:
    tab.until(
        f"document.querySelector('#one-title').textContent === 'Trace of {impact}' "
        "&& document.querySelector('#trace').children.length > 0"
    )


def heaps_of_new_pages(port: int, last: str) -> list[float]:
    """Of pages that have just been opened, and show the same."""
    sizes = []
    for _ in range(PAGES):
        with browser.Browser() as page:
            page.open(address(port))
            until_shown(page, last)
            sizes.append(heap(page))
    return sizes


@pytest.mark.usefixtures("traced")
def test_a_thousand_drops_and_a_thousand_changes(begin: Callable[[], Watch], recorded: Path) -> None:
    for name in plan_of_drops(6):
        write(recorded, name, drop(name))
    watch = begin()
    watch.catch_up(0)
    first = list(watch.drops)

    def fall(number: int) -> str:
        """One more drop, fed into the list of the watch; its recording is that of one that was taken."""
        taken, name = first[number % len(first)], f"more-{number}"
        cells = {**taken.cells, "impact": name}
        watch.drops.taken(replace(taken, file=f"{name}.csv", sha256=name, cells=cells, taken=name))
        watch.say(watch.line(watch.drops.named(name)))
        return name

    def change(number: int) -> None:
        """A decision on one of few drops."""
        impact = f"more-{1 + number % APART}"
        watch.drops.decide(impact, "" if watch.drops.named(impact).left_out else "again")
        watch.say(f"{number}: {impact}")
        tab.until(f"document.querySelector('#log li').textContent.startsWith('{number}:')")

    with served(WatchView(watch)) as port, browser.Browser() as tab:
        tab.open(address(port))
        tab.until("document.querySelectorAll('#drops tbody tr').length === 6")
        falls, changes, new = [], [], []
        for number in range(1, EVENTS + 1):
            until_shown(tab, fall(number))
            if number % APART == 0 and number >= WARM_UP:
                falls.append((number, heap(tab), held_here()))
            if number in (EVENTS // 2, EVENTS):
                new.append(heaps_of_new_pages(port, f"more-{number}"))
        for number in range(1, EVENTS + 1):
            change(number)
            if number % APART == 0 and number >= WARM_UP:
                changes.append((number, heap(tab), held_here()))
    number, held, memory = np.array(falls).T
    a_drop, served_drop = slope(number, held), slope(number, memory)
    number, kept, memory_kept = np.array(changes).T
    a_change, served_change = slope(number, kept), slope(number, memory_kept)
    # What the same drops cost pages that were not open all the while.
    a_row = (np.mean(new[1]) - np.mean(new[0])) / (EVENTS / 2)
    row_error = np.sqrt(sum(np.var(sizes, ddof=1) for sizes in new) / PAGES) / (EVENTS / 2)
    text = (watch.drops.folder / LIST).stat().st_size / len(watch.drops.drops)
    for name, value in {
        "page, bytes a drop": a_drop,
        "new page, bytes a drop": Slope(float(a_row), float(row_error)),
        "page, bytes a change": a_change,
        "server, bytes a drop": served_drop,
        "server, bytes a change": served_change,
        "heap of the page, bytes, first and last": (held[0], kept[-1]),
        "server, bytes, first and last": (memory[0], memory_kept[-1]),
    }.items():
        logging.getLogger(__name__).info("%s: %s", name, value)
    assert a_drop.value - a_row < SURE * np.hypot(a_drop.error, row_error), "a row is all that a drop adds"
    # Each change replaces a row in the page, and a drop's text in the server: neither is held on to.
    assert a_change.value + SURE * a_change.error < a_drop.value
    assert served_change.value + SURE * served_change.error < text
