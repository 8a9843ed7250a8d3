"""A run with a discrepancy: the tissue's stiffness is K_secant, and K is the element's own."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayestissue import Fit
from bayestissue.base.results.tables import table_of_rows
from bayestissue.inference.checking.findings import ELEMENT_ALONE
from bayestissue.reports.pages.answers_page import question_lines
from bayestissue.reports.pages.fit import figures, method_agreement
from bayestissue.reports.pages.fit.fit_run import own_slopes
from bayestissue.reports.pages.posterior import mass_curve
from make_fit_run import fit_run


@pytest.fixture(scope="module")
def run() -> Fit:
    return fit_run(own_depth=0.3, two_sides=True, discrepancy=True)


def test_impacts_show_it_beside_point_estimates_and_truth(run: Fit) -> None:
    rows = run.summary[run.summary["variable"] == "K_secant"].set_index("label")
    table = run.estimates_by_method["K"]
    np.testing.assert_array_equal(table["median"], rows["median"].reindex(table.index))
    assert list(method_agreement.held_by_intervals(run)["quantity"]) == ["K_secant", "K_secant", "C", "C"]
    assert method_agreement.dds_ratio(run, "K") == pytest.approx((table["dds"] / table["median"]).median())
    axes = json.dumps(figures.impacts(run, "order", "K").specification())
    assert "secant stiffness K_secant (N/m)" in axes
    assert {row.cells[0] for row in method_agreement.agreement_table(run).rows} == {"K_secant", "C"}


def test_people_have_their_own_impacts_secants_and_other_groups_none(run: Fit) -> None:
    drawn = figures.people(run, "K").data.set_index("label")["median"]
    expected = np.median(run.draws("K_secant_of_subject"), axis=0)
    np.testing.assert_allclose(drawn[run.labels("subject")], expected)
    assert run.of_levels("K", "trial") == ""
    names = [name for name, _ in figures.published(run)]
    assert "K-by-subject" in names
    assert {"K-by-trial", "K-by-side"}.isdisjoint(names)
    assert {"C-by-trial", "K-over-mass"} <= set(names)
    assert all(slope.quantity != "K" for slope in own_slopes(run))


def test_the_curve_over_the_mass_is_that_of_the_recorded_impacts(run: Fit) -> None:
    masses = run.constant("mass_kg")
    curve = mass_curve(run, "K", masses, run.reference_mass)
    at = np.exp(np.log(masses).mean())
    middle = np.exp(np.interp(np.log(at), np.log(curve["mass_kg"]), np.log(curve["median"])))
    assert middle == pytest.approx(np.median(run.draws("K_secant_of_impacts")), rel=1e-3)
    slope = np.log(curve["median"].iloc[-1] / curve["median"].iloc[0])
    slope /= np.log(curve["mass_kg"].iloc[-1] / curve["mass_kg"].iloc[0])
    assert slope == pytest.approx(np.median(run.draws("mass_exponent_K_secant")), abs=0.01)


def test_an_answer_of_the_element_s_k_says_so_on_the_first_screen() -> None:
    of_claim = {"posterior": 0.6, "prior": 0.5, "note": f"rough; {ELEMENT_ALONE}"}
    of_number = {"median": 1200.0, "low": 1100.0, "high": 1300.0, "unit": "N/m", "note": ELEMENT_ALONE}
    rows = [of_claim, of_number]
    table = table_of_rows("questions", [{"question": "K", "name": "", "unit": "", **row} for row in rows])
    beside = [line["beside"] for line in question_lines(table)]
    assert beside == [f"prior 0.50; {ELEMENT_ALONE}", f"1100 to 1300; {ELEMENT_ALONE}"]
