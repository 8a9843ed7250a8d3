"""The page of the thesis's published values: of the run that is stored, and of changed ones."""

from __future__ import annotations

import json
import re

import pytest
import xarray as xr

from bayestissue.reports.pages import write_report
from cases import cases
from make_published_run import make_published_run
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


def test_the_page_has_four_sections_and_the_rest_within_them(html):
    links = re.findall(r'<a href="#(\w+)">', html[html.index("<nav") : html.index("</nav>")])
    assert links == ["mass", "audit", "estimates", "trust"]
    main = html[html.index("<main>") : html.index('<section id="warnings">')]
    assert len(re.findall("<h2>", main)) == 4


@pytest.mark.slow
def test_a_failed_run_is_loud_on_the_first_screen(tmp_path):
    folder = make_published_run(tmp_path)
    for name, wrong in (
        ("diagnostics", {"passed": False}),
        ("run", {"verdict": {"passed": False, "words": "R-hat"}}),
    ):
        path = folder / f"{name}.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | wrong))
    first = first_screen(write_report(folder).read_text(encoding="utf-8"))
    assert "DIAGNOSTICS FAILED" in first
    assert 'class="verdict failed"' in first


@pytest.mark.slow
def test_a_model_without_a_mass_exponent_still_gets_a_page(tmp_path):
    folder = make_published_run(tmp_path)
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        tree.load()
    left = tree["posterior"].to_dataset().drop_vars(["mass_exponent_K", "mass_exponent_C"])
    tree["posterior"] = xr.DataTree(left)
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    assert "no mass exponent" in first_screen(write_report(folder).read_text(encoding="utf-8"))
