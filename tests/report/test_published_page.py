from __future__ import annotations

import re
import shutil

import pytest

from bayestissue.reports.pages import write_report
from make_published_run import make_published_run
from page_reader import Reader


@pytest.fixture(scope="module")
def html(published_run_folder):
    return write_report(published_run_folder).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html):
    reader = Reader()
    reader.feed(html)
    assert reader.open == []
    return reader


def first_screen(html):
    return html[html.index('class="first"') : html.index("<nav")]


def test_every_link_leads_somewhere_in_the_page(page):
    assert all(link.startswith("#") for link in page.links)
    assert {link[1:] for link in page.links} <= set(page.ids)


def test_no_name_is_given_twice(page):
    assert len(page.ids) == len(set(page.ids))


def test_the_page_asks_nothing_of_the_network(html, page):
    assert all(source.startswith("data:") for source in page.sources)
    assert not re.search(r'(?:src|href)="(?:https?:)?//', html)
    assert "@import" not in html


def test_every_figure_says_what_it_shows(page):
    assert page.unnamed == 0


def test_the_first_screen_begins_with_what_was_found_and_doubts_k_and_c_last(html):
    first = first_screen(html)
    found = re.search(r"K repeats the mass: K ∝ M<sup>0\.9\d+</sup>", first)
    picture, audit = first.index('data-name="K-over-mass"'), first.index("What else the audit found")
    doubt = first.index("Do not use these K and C as the tissue’s.")
    values = re.search(r"K = <b>\d+\.\d+</b> N/m", first)
    assert found.start() < picture < audit < doubt < values.start()
    assert html.count(values[0]) == 1
    assert re.search(r"People differ by ±\S+\s% in K and ", first)
    assert "Diagnostics passed." not in first
    assert "Diagnostics passed." in html


def test_the_page_has_four_sections_and_the_rest_within_them(html):
    links = re.findall(r'<a href="#(\w+)">', html[html.index("<nav") : html.index("</nav>")])
    assert links == ["mass", "audit", "estimates", "trust"]
    main = html[html.index("<main>") : html.index('<section id="warnings">')]
    assert len(re.findall("<h2>", main)) == 4


def test_the_worst_findings_stand_on_the_first_screen_and_are_escaped(html):
    first = first_screen(html)
    assert [
        first.count(words) for words in ("K against the mass of the impactor", "implied penetration")
    ] == [0, 1], "the headline says the first"
    assert "energy &lt;is&gt; not" in first


@pytest.mark.slow
def test_a_failed_run_is_loud_on_the_first_screen(tmp_path):
    html = write_report(make_published_run(tmp_path, passed=False)).read_text(encoding="utf-8")
    first = first_screen(html)
    assert "DIAGNOSTICS FAILED" in first
    assert 'class="verdict failed"' in first
    assert "Draw longer chains." in html


def test_disagreements_are_marked_and_counted(html):
    assert html.count('<tr class="disagrees"><td class="text">5.10') == 1
    assert "1 agree with the printed number" in html
    assert "The other 1 can't be derived" in html


def test_model_priors_and_provenance_are_told(html):
    for words in (
        "log K ~ log(mass_kg) + (1|subject)",
        "normal, mean 0.5, sd 1",
        "lkj, concentration 2",
        "sampler.effective",
        "0123456789abcdef",
        "numpy 2.3",
    ):
        assert words in html


@pytest.mark.slow
def test_a_model_without_a_mass_exponent_still_gets_a_page(published_run_folder, tmp_path):
    import xarray as xr

    folder = shutil.copytree(published_run_folder, tmp_path / "run")
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        tree.load()
    left = tree["posterior"].to_dataset().drop_vars(["mass_exponent_K", "mass_exponent_C"])
    tree["posterior"] = xr.DataTree(left)
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    html = write_report(folder).read_text(encoding="utf-8")
    assert "no mass exponent" in first_screen(html)
