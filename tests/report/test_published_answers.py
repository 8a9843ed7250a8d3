from __future__ import annotations

import pytest

from bayestissue.model.hierarchy.derived import hypotheses
from bayestissue.reports.pages import posterior
from bayestissue.reports.pages.page import worded
from bayestissue.reports.pages.run_folder import read_about
from bayestissue.reports.pages.wording import Spread
from bayestissue.thesis import published_page as page
from bayestissue.thesis.published_run import PublishedRun, kept_share
from make_fit_run import changed


def read(folder):
    return PublishedRun.read(folder, read_about(folder)).complete()


def with_draws(run, **draws):
    return changed(run, groups={"posterior": run.groups["posterior"].assign(draws)})


@pytest.fixture(scope="module")
def run(published_run_folder):
    return read(published_run_folder)


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (-0.1, 0.4, "includes 0 (fixed stiffness) and excludes 1"),
        (0.4, 0.6, "it lies between"),
        (-0.6, -0.2, "it lies below both"),
    ],
)
def test_an_interval_is_said_to_hold_what_it_holds(low, high, said):
    assert said in worded("fit", "exponent", True, Spread((low + high) / 2, low, high))


def test_a_constant_frequency_that_the_audit_confirms_is_called_made_by_the_method(run):
    assert page.constant_frequency_finding(run) == 0
    assert page.headline(run) == "K repeats the mass"
    assert page.first_findings(run)[0]["what"] == "penetration that K and C imply"
    assert "Made by the method" in page.mass_conclusion(run)
    assert "no information on the tissue" in page.mass_conclusion(run)


def test_without_the_audits_word_the_conclusion_is_weaker(run):
    silent = changed(run, audit=run.audit.iloc[1:].reset_index(drop=True))
    assert page.constant_frequency_finding(silent) is None
    assert "Made by the method" not in page.mass_conclusion(silent)
    assert "in proportion to mass" in page.mass_conclusion(silent)


@pytest.mark.parametrize(
    ("exponent", "headline", "said"),
    [
        (0.0, "K does not depend on the mass", "fixed stiffness"),
        (1.5, "K grows with the mass", "faster than the mass"),
        (-0.5, "K falls as the mass grows", "falls as mass grows"),
    ],
)
def test_other_exponents_lead_to_other_words(run, exponent, headline, said):
    draws = run.groups["posterior"]["mass_exponent_K"]
    moved = draws - draws.mean() + exponent
    other = with_draws(run, mass_exponent_K=moved)
    other = changed(other, hypotheses=hypotheses({"K": moved.to_numpy()}, 0.1))
    assert page.headline(other) == headline
    assert said in page.mass_conclusion(other)


def test_a_wide_interval_decides_nothing(run):
    draws = run.groups["posterior"]["mass_exponent_K"]
    wide = with_draws(run, mass_exponent_K=0.5 + 60 * (draws - draws.mean()))
    vague = changed(wide, hypotheses=run.hypotheses.assign(probability=0.1))
    assert "do not decide" in page.mass_conclusion(vague)


def test_a_model_without_mass_says_so(run):
    drawn = run.groups["posterior"].drop_vars(["mass_exponent_K", "mass_exponent_C"])
    without = changed(run, groups={"posterior": drawn})
    assert posterior.mass_exponents(without) == []
    assert "no mass exponent" in page.mass_conclusion(without)


def test_a_posterior_that_ignores_the_data_keeps_nothing_and_one_that_repeats_them_keeps_all(run):
    drawn = run.groups["posterior"]["K"]
    levels = run.groups["posterior"]["K_trial"].to_numpy()[..., run.constant("impact_trial")]
    assert kept_share(with_draws(run, K=drawn.copy(data=levels)), "K") == pytest.approx(0, abs=0.01)
    assert kept_share(with_draws(run, K=0 * drawn + run.observed("K_observed")), "K") == pytest.approx(1)
