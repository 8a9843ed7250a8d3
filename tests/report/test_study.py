"""Comparisons, reliability and agreement of methods on the page of a fit."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
import pytest

from bayestissue.reports.pages import write_report
from make_fit_run import make_fit_run
from page_reader import Reader

pytestmark = pytest.mark.usefixtures("read_once")


def plain(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("\N{NO-BREAK SPACE}", " ")


def section(html: str, name: str) -> str:
    part = html[html.index(f'<section id="{name}"') :]
    return part[: part.index("</section>")]


@pytest.fixture(scope="module")
def html(tmp_path_factory) -> str:
    folder = make_fit_run(tmp_path_factory.mktemp("study") / "run", two_sides=True)
    return write_report(folder).read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_first_screen_says_what_differs_and_the_comparisons_all_of_it(html) -> None:
    first = plain(html[html.index('class="first"') : html.index("<nav")])
    assert "What are K and C, and what differs by side?" in first
    assert re.search(r"K, left over right: × 1\.\d+ \(1\.\d+ to 1\.\d+\), almost certainly greater\.", first)
    assert re.search(
        r"C, left over right: × [01]\.\d+ \(.*?\), almost certainly the same within 10 %\.", first
    )
    compared = plain(section(html, "comparisons"))
    ratios = r"left over right: K × 1\.\d+ 1\.\d+ to 1\.\d+; C × [01]\.\d+ .*; peak force × 1\.\d+"
    assert re.search(ratios, compared)
    assert "K is almost certainly greater for left (probability above 0.999)" in compared
    assert "that it differs by less than 10 % is" in compared
    page = Reader()
    page.feed(html)
    assert page.open == []
    assert "comparisons" in page.ids


INTERACTION = {"factor": "group:session", "level": "treated:after/before", "against": "control:after/before"}
RATIO = {"ratio": 1.22, "low": 1.1, "high": 1.35, "p_direction": 0.98, "p_equivalent": 0.12}


def test_an_interaction_leads_and_what_goes_with_a_level_is_said(tmp_path) -> None:
    folder = make_fit_run(tmp_path / "run", two_sides=True)
    table = pd.read_csv(folder / "contrasts.csv").assign(note="also differs: pad (p1 against p2)")
    further = pd.DataFrame([INTERACTION | RATIO | {"quantity": q, "kind": "interaction"} for q in "KC"])
    pd.concat([table, further]).to_csv(folder / "contrasts.csv", index=False)
    html = write_report(folder).read_text(encoding="utf-8")
    first = plain(html[html.index('class="first"') : html.index("<nav")])
    led = "K, after over before, treated over control: × 1.22 (1.10 to 1.35), very probably greater."
    assert led in first
    compared = plain(section(html, "comparisons"))
    assert "Interaction: after over before, treated over control: K × 1.22 1.10 to 1.35" in compared
    words = "K, after over before, is very probably greater for treated than for control (probability 0.98)"
    assert words in compared
    assert "Between left and right also differs, and is part of the ratio: pad (p1 against p2)." in compared
    assert "treated:after/before over control:after/before" in section(html, "comparisons")
    assert "also differs: pad" in section(html, "comparisons")


def test_columns_in_no_formula_lead_the_first_screen_as_questions(tmp_path) -> None:
    folder = make_fit_run(tmp_path / "run", two_sides=True)
    path = folder / "run.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    pad = {
        "column": "pad",
        "number": False,
        "varies": "4 levels",
        "formula": "log(mass_kg) + pad + (1|subject)",
    }
    path.write_text(json.dumps(record | {"columns_not_used": [pad]}), encoding="utf-8")
    html = write_report(folder).read_text(encoding="utf-8")
    first = plain(html[html.index('class="first"') : html.index("<nav")])
    assert "Varies, and is in no formula: pad pad varies" in first
    assert first.index("pad varies") < first.index("what differs by side")
    asked = "pad varies (4 levels) and is not in the formula: does K differ by pad? --K"
    assert f"{asked} &#34;{pad['formula']}&#34;" in first


def test_every_comparison_stands_in_a_table(html) -> None:
    part = section(html, "comparisons")
    assert "left over right" in part
    assert "from 0.909 to 1.100" in plain(part)
    # Conditions stand for masses in these data.
    assert "t0 over t1" not in part
    assert "conditions stand for masses" in part
    assert "K[subject=s01] &gt; K[subject=s02]" in part


def test_outcomes_of_a_comparison_stand_side_by_side(html) -> None:
    part = section(html, "comparisons")
    text = plain(part)
    assert re.search(r"The same in what an impact of [\d.]+ kg at [\d.]+ m/s does", text)
    heading = "of comparison peak force peak depth energy absorbed"
    cell = r"\d\.\d+ \(\d\.\d+ to \d\.\d+\)"
    assert re.search(rf"{heading} side left over right {cell} {cell} {cell}", text)
    # K and C alone stand in the first table.
    first, then = part.index("Ratios of K and of C"), part.index("The same in what")
    assert plain(part[first:]).count("left over right") == 3
    assert "peak force" not in plain(part[first:then])


def test_reliability_is_told_in_words_and_in_a_table(html) -> None:
    text = plain(section(html, "reliability"))
    change = r"A person’s K must change by \d+\.\d % to show \(95 %, all else the same\)\."
    assert re.search(rf"{change} Its ICC\(A,1\) is 0\.\d+ \(0\.\d+ to \d\.\d+\)\. A person’s C", text)
    for words in ("ICC(C,k), k = 3", "minimal detectable change", "taken as known", "ICC(A,k) of 0.75"):
        assert words in text


@pytest.mark.slow
def test_what_the_data_leave_to_the_prior_is_said(tmp_path) -> None:
    folder = make_fit_run(tmp_path / "run")
    table = pd.read_csv(folder / "reliability.csv")
    agreement = table["form"].str.startswith(("ICC(A,1", "agreement"))
    table["prior_overlap"] = np.where(agreement & (table["quantity"] == "K"), 0.62, 0.2)
    table.to_csv(folder / "reliability.csv", index=False)
    text = plain(section(write_report(folder).read_text(encoding="utf-8"), "reliability"))
    assert "Largely prior: of ICC(A,1) of K and standard error of measurement (agreement) of K these" in text
    assert "overlaps the prior of the model file by 62 %" in text
    assert "of which few conditions say little" in text
    assert re.search(r"ICC\(A,1\) \S+ \S+ to \S+, largely prior \S+ \S+ to \S+ intraclass", text)


def test_methods_stand_side_by_side_with_limits_of_agreement(html) -> None:
    part = section(html, "agreement")
    # Of K and of C.
    assert part.count('class="chart"') == 2
    # The made-up thesis's K is twice the truth.
    found = re.search(r"thesis&#39;s method over posterior median</td><td[^>]*>(\d\.\d+)", part)
    assert found is not None
    assert float(found[1]) == pytest.approx(2, abs=0.02)


def test_a_study_with_nothing_to_compare_says_so(tmp_path) -> None:
    html = write_report(make_fit_run(tmp_path / "run")).read_text(encoding="utf-8")
    assert "and what differs by" not in html
    assert "No formula of this model compares levels" in html


def test_what_counts_as_equal_is_the_model_s_own_range_everywhere(tmp_path) -> None:
    folder = make_fit_run(tmp_path / "run", two_sides=True)
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    record["model"]["practical_equivalence"] = {"ratio": 0.07, "mass_exponent": 0.2}
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")
    text = plain(write_report(folder).read_text(encoding="utf-8"))
    ranges = re.findall(r"differs by less than (\S+ %)|within (\S+ %)|from (0\.9\d+) to (1\.\d+)", text)
    stated = {part for found in ranges for part in found if part}
    assert stated == {"7.0 %", "0.935", "1.070"}
