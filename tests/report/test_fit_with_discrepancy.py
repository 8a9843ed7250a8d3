"""A run with a discrepancy: the tissue's stiffness is K_secant, and K is the element's own."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from bayestissue.base.results.tables import table_of_rows
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.reports.pages.answers_page import question_lines
from bayestissue.reports.pages.fit import answers, figures, groups, method_agreement, model_words
from bayestissue.reports.pages.fit.fit_page import page_of
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.posterior import exponent, levels, mass_curve, spread
from bayestissue.reports.paper.text import text_of
from make_fit_run import MASS, changed, make_fit_run, read_fit_run


def read(folder: Path) -> FitRun:
    return read_fit_run(folder, json.loads((folder / "run.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> FitRun:
    folder = tmp_path_factory.mktemp("discrepancy") / "run"
    options = {"likelihood": "impact", "exponent": 0.0, "own_depth": 0.3, "two_sides": True}
    return read(make_fit_run(folder, discrepancy=True, **options))


def plain(html: str) -> str:
    return unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", html))).replace("\N{NO-BREAK SPACE}", " ")


def test_the_first_screen_leads_with_the_secant_stiffness(run: FitRun) -> None:
    html = page_of(run)
    first = plain(html[html.index('class="first"') : html.index("<nav")])
    together = spread(run.draws("K_secant_of_impacts"))
    assert "K_secant of each, beside these impacts together (dashed)." in first
    # K is of these impacts, and C of a typical person.
    assert f"secant stiffness K_secant of these impacts {together.value} N/m {together.range}" in first
    assert f"damping C {levels(run)[1].typical.value} N s/m" in first
    assert "Typical person, 90 % interval" in first
    assert "It is force over depth at the greatest depth" in first
    assert "K = " not in first
    assert "K at 12 mm is almost certainly independent of the mass: exponent" in first
    assert f", at own depths (drawn) {exponent(run, 'K_secant').words}; " in first
    # Half of it in these made-up draws, and nowhere on the first screen.
    assert spread(run.draws("K_new")).value not in first
    assert levels(run)[1].quantity == "C"


def test_a_heading_of_the_first_screen_is_shown_with_a_picture_only(tmp_path: Path) -> None:
    """K of nobody is told here, so that its only picture has every impact."""

    def without(groups: dict[str, xr.Dataset]) -> dict[str, xr.Dataset]:
        return groups | {"posterior": groups["posterior"].drop_vars("K_secant_of_subject")}

    options = {"likelihood": "impact", "exponent": None, "mass_varies": False, "extended": without}
    html = page_of(read(make_fit_run(tmp_path / "run", discrepancy=True, **options)))
    assert re.search(r'<div class="not-of-K">\s*<h2 id="answer-3">How do impacts differ', html)
    assert re.search(r'<div>\s*<h2 id="answer-1">What are K and C', html)


def test_impacts_show_it_beside_point_estimates_and_truth(run: FitRun) -> None:
    rows = run.summary[run.summary["variable"] == "K_secant"].set_index("label")
    table = run.estimates_by_method["K"]
    np.testing.assert_array_equal(table["median"], rows["median"].reindex(table.index))
    assert list(method_agreement.held_by_intervals(run)["quantity"]) == ["K_secant", "K_secant", "C", "C"]
    assert method_agreement.dds_ratio(run, "K") == pytest.approx(2, rel=0.05)
    titles = [column.title for column in method_agreement.estimates_table(run).columns]
    assert {"K_secant (N/m)", "true K_secant"} <= set(titles)
    axes = json.dumps(figures.impacts(run, "order", "K").specification())
    assert "secant stiffness K_secant (N/m)" in axes
    assert {row.cells[0] for row in method_agreement.agreement_table(run).rows} == {"K_secant", "C"}
    assert "on the same traces (median impact)" in answers.method_sentence(run)
    assert "times this K_secant" in answers.method_sentence(run)


def test_people_have_their_own_impacts_secants_and_other_groups_none(run: FitRun) -> None:
    drawn = figures.people(run, "K").data.set_index("label")["median"]
    expected = np.median(run.draws("K_secant_of_subject"), axis=0)
    np.testing.assert_allclose(drawn[run.labels("subject")], expected)
    assert run.of_levels("K", "trial") == ""
    names = [name for name, _ in figures.published(run)]
    assert "K-by-subject" in names
    assert {"K-by-trial", "K-by-side"}.isdisjoint(names)
    assert {"C-by-trial", "K-over-mass"} <= set(names)
    assert all(slope.quantity != "K" for slope in groups.own_slopes(run))


def test_the_curve_over_the_mass_is_that_of_the_recorded_impacts(run: FitRun) -> None:
    masses = run.constant("mass_kg")
    curve = mass_curve(run, "K", masses, run.reference_mass)
    at = np.exp(np.log(masses).mean())
    middle = np.exp(np.interp(np.log(at), np.log(curve["mass_kg"]), np.log(curve["median"])))
    assert middle == pytest.approx(np.median(run.draws("K_secant_of_impacts")), rel=1e-3)
    slope = np.log(curve["median"].iloc[-1] / curve["median"].iloc[0])
    slope /= np.log(curve["mass_kg"].iloc[-1] / curve["mass_kg"].iloc[0])
    assert slope == pytest.approx(np.median(run.draws("mass_exponent_K_secant")), abs=0.01)
    conditions = figures.mass(run, "K")
    assert "mean of impacts" in json.dumps(conditions.specification())
    assert len(MASS) == len(run.labels("trial"))


def test_words_say_whose_k_is(run: FitRun) -> None:
    said = model_words.likelihood_words(run)
    assert "the element's own" in said
    assert "The tissue's stiffness is K_secant." in said
    assert answers.answering(run) == {"K": "K_common_depth", "C": "C"}
    alone = changed(
        run,
        groups=run.groups
        | {"posterior": run.groups["posterior"].drop_vars(["mass_exponent_K_common_depth"])},
    )
    assert answers.answering(alone)["K"] == "K_secant"
    paper = " ".join(text_of(run).sections["Results"])
    assert "Of these impacts together (geometric mean) K_secant, force over depth" in paper
    assert not re.search(r"\bK was\b", paper)
    first = text_of(run).table[""].iloc[0]
    assert first.startswith("K_secant, these impacts together")


def test_an_answer_of_the_element_s_k_says_so_on_the_first_screen() -> None:
    of_claim = {"posterior": 0.6, "prior": 0.5, "note": f"rough; {ELEMENT_ALONE}"}
    of_number = {"median": 1200.0, "low": 1100.0, "high": 1300.0, "unit": "N/m", "note": ELEMENT_ALONE}
    rows = [of_claim, of_number, of_number | {"note": ""}]
    table = table_of_rows("questions", [{"question": "K", "name": "", "unit": "", **row} for row in rows])
    beside = [line["beside"] for line in question_lines(table)]
    assert beside == [
        f"prior 0.50; {ELEMENT_ALONE}",
        f"1100 to 1300; {ELEMENT_ALONE}",
        "1100 to 1300",
    ]
