from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import stats

from bayestissue.reports.pages.fit import answers, checks, method_agreement, model_words, trace_predictions
from bayestissue.reports.pages.run_folder import read_about
from make_fit_run import DRAWS, changed, make_fit_run, read_fit_run

pytestmark = pytest.mark.usefixtures("read_once")


def read(folder):
    return read_fit_run(folder, read_about(folder))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return read(make_fit_run(tmp_path_factory.mktemp("fit") / "run"))


@pytest.fixture(scope="module")
def arma(tmp_path_factory):
    return read(make_fit_run(tmp_path_factory.mktemp("arma") / "run", likelihood="arma", coloured=True))


@pytest.mark.slow
def test_the_intervals_that_hold_the_truth_are_counted(run):
    half, most = method_agreement.held_by_intervals(run).query("quantity == 'K'").itertuples()
    assert (half.level, most.level, most.impacts) == (50, 90, 12)
    # Made-up medians scatter about the truth as widely as their draws: coverage is that of the normal.
    assert stats.binom.cdf(most.held, 12, 0.9) > 0.001
    assert half.held <= most.held


def test_least_squares_finds_the_slope_that_was_put_in(run):
    # C of the made-up estimates is 3 C_person M^(1/2) and every person meets every mass.
    found = method_agreement.apparent_exponent(run, "C")
    assert found.slope.median == pytest.approx(0.5, abs=1e-12)
    assert found.slope.low < 0.5 < found.slope.high
    level = np.log(3 * run.truth["C_N_s_per_m"]).mean() + 0.5 * np.log(0.7)
    assert found.intercept == pytest.approx(level, abs=1e-12)


def test_the_ratio_of_the_methods_is_that_of_the_made_up_estimates(run):
    # Medians of 200 draws about a made-up centre, itself 1 % off: three standard errors of the middle of 12.
    assert method_agreement.dds_ratio(run, "K") == pytest.approx(2, rel=3 * 1.25 * 0.01 / np.sqrt(12))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exponent", "said"),
    [
        (0.0, "neither K nor C depends"),
        (1.0, "K almost certainly grows in proportion to the mass"),
        (0.5, "K grows with the mass"),
        (-0.5, "K falls with the mass"),
    ],
)
def test_exponents_lead_to_words(tmp_path, exponent, said):
    assert said in answers.mass_conclusion(read(make_fit_run(tmp_path, exponent=exponent)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("common", "own", "conclusion", "told"),
    [
        (
            0.0,
            0.3,
            "neither K nor C depends",
            "The tissue's law is the same for every mass: heavier impactors",
        ),
        (0.1, 0.5, "K grows with the mass", "the law itself differs between the masses too"),
        (0.0, 0.0, "neither K nor C depends", "(−0.0"),
    ],
)
def test_mass_is_answered_at_the_depth_that_all_impacts_reach(tmp_path, common, own, conclusion, told):
    run = read(make_fit_run(tmp_path, exponent=common, own_depth=own))
    assert answers.answering(run) == {"K": "K_common_depth", "C": "C"}
    assert conclusion in answers.mass_conclusion(run)
    said = str(answers.depth_sentence(run)).replace("\N{NO-BREAK SPACE}", " ")
    assert said.startswith("Here K is force over depth at 12 mm, which every impact reaches.")
    assert "At each impact's own greatest depth K ∝ M<sup>" in said
    assert told in said
    assert ("deeper, where it is stiffer" in said) == (own > 0)


@pytest.mark.slow
def test_a_law_that_may_be_the_same_is_not_called_so(tmp_path):
    run = read(make_fit_run(tmp_path, exponent=0.0, own_depth=0.5))
    run.hypotheses.loc[run.hypotheses["quantity"] == "K_common_depth", "probability"] = 0.6
    said = str(answers.depth_sentence(run))
    assert "One law of the tissue for every mass explains this: heavier impactors go deeper" in said


@pytest.mark.slow
def test_k_that_is_not_told_at_one_depth_is_said_to_be_of_the_depth_too(tmp_path):
    run = read(make_fit_run(tmp_path, likelihood="impact", exponent=0.3, own_depth=0.3))
    run.about["discrepancy"] = {"rms_of_peak": 0.05}
    assert "reaches, if the damper is the same at all depths. At each" in str(answers.depth_sentence(run))
    assert "It is assumed that the damper is the same at all depths." in answers.further_words(run)[0]
    del run.groups["posterior"]["mass_exponent_K_common_depth"]
    assert answers.answering(run)["K"] == "K"
    assert "depth alone may make its exponent, and C's" in str(answers.depth_sentence(run))
    assert answers.further_words(run)[0].startswith("C is the damping constant of the element beside")
    assert "K grows with the mass" in answers.mass_conclusion(run)


def test_stiffness_that_no_depth_changes_is_answered_as_it_is(run):
    assert answers.answering(run) == {"K": "K", "C": "C"}
    assert answers.depth_words(run) == str(answers.depth_sentence(run)) == ""
    assert answers.further_words(run) == []


def test_a_trend_that_the_posterior_shares_is_not_called_made_by_the_method(run, tmp_path):
    assert [answers.made_by_method(run, q) for q in "KC"] == [False, True]
    sloped = read(make_fit_run(tmp_path, exponent=0.5))
    assert not answers.made_by_method(sloped, "K")


def test_noise_that_is_not_the_models_is_told(run, arma):
    white, coloured = trace_predictions.residuals(run), trace_predictions.residuals(arma)
    pairs = ((run, white), (arma, coloured))
    said = [" ".join(trace_predictions.residual_words(each, left)) for each, left in pairs]
    assert "is not the noise that was recorded" not in said[0]
    assert "is not the noise that was recorded" in said[1]


def test_what_the_fit_tested_is_the_pages_one_verdict(run, arma):
    """No other test of the same residuals."""
    coloured = trace_predictions.residuals(arma)
    form = {"words": "Nothing against the model.", "impacts": {"p": dict.fromkeys(run.impacts, 0.5)}}
    about = run.record | {"model": run.record["model"] | {"likelihood": "impact"}}
    tested = changed(run, record=about, diagnostics=run.diagnostics | {"model_form": form})
    assert trace_predictions.residual_words(tested, coloured)[1:] == [form["words"]]
    assert not trace_predictions.other_noise(tested, coloured)


def test_the_lag_one_autocorrelation_is_that_of_a_running_mean(arma):
    # Of a running mean of two it is 1/2, with a standard error of about 1/sqrt(n) an impact, n = 58 or more;
    # each of the four coefficients of the cubic takes about 1/n off.
    found = trace_predictions.residuals(arma).lag_one["measured"].mean()
    assert found == pytest.approx(0.5, abs=4 / np.sqrt(58 * 12) + 4 / 58)


def test_the_recording_shown_first_is_that_of_the_median_stiffness(run):
    level = run.of_impacts("K")["median"].to_numpy()[run.predicted]
    place = trace_predictions.middle_impact(run)
    assert (level < level[place]).sum() == len(level) // 2
    rows = trace_predictions.trace_rows(run, place)
    recorded = run.groups["observed_data"][run.shown].to_numpy()[place]
    np.testing.assert_array_equal(rows["recorded"], recorded[np.isfinite(recorded)])
    bands = rows[["low", "quarter", "median", "three_quarters", "high"]].to_numpy()
    assert np.all(np.diff(bands, axis=1) >= 0)


def test_the_chain_table_sets_what_was_declared_beside_what_was_found(run):
    rows = {row.cells[0]: row.cells for row in checks.chain_table(run).rows}
    # 2 per thousand of the median mass of 0.7 kg
    assert rows["mass of the impactor"][1:3] == ("g", "1.4")
    share = float(rows["mass of the impactor"][4].split("\N{NO-BREAK SPACE}")[0])
    # The made-up draws are the declared error's: a standard deviation of 2 * DRAWS of them.
    assert share == pytest.approx(100, abs=4 * 100 / np.sqrt(2 * 2 * DRAWS))
    assert rows["displacement at contact, from the time of contact"][2] == "read off each trace"


def test_an_error_of_mass_that_is_a_persons_is_said(run):
    assert "no surer than that mass" not in checks.declared_words(run)
    model = run.record["model"] | {"mass_error": "subject"}
    given = run.record["uncertainty"] | {"relative_mass_sd": 0.2}
    shared = changed(run, record=run.record | {"model": model, "uncertainty": given})
    assert "mass 20 %" in checks.declared_words(shared).replace("\N{NO-BREAK SPACE}", " ")
    assert "no surer than that mass" in checks.declared_words(shared)
    of_masses = changed(run, record=shared.record | {"model": model | {"mass_error": "mass"}})
    assert "no surer than the masses" in checks.declared_words(of_masses)


def test_theta1_at_its_edge_is_counted_and_impact_toml_named(run, arma):
    assert "below −0.99 in 12 of 12" in " ".join(model_words.limits(arma))
    assert "models/impact.toml" in model_words.limits(run)[0]


def test_coverage_is_shown_once_it_was_measured(run, tmp_path, monkeypatch):
    path = tmp_path / "coverage.csv"
    path.write_text("likelihood,quantity,level,held,impacts,command,measured\n", encoding="utf-8")
    monkeypatch.setattr(model_words, "_MEASURED", path)
    assert model_words.coverage_table(run) is None
    with path.open("a", encoding="utf-8") as stream:
        stream.write("a2,K,90,1500,2000,a command,on an earlier version\narma,K,90,1,2,another,\n")
    (row,) = model_words.coverage_table(run).rows
    # When and by which program it was measured is no concern of a lab's.
    assert row.cells == ("K", "90 %", "1500 of 2000", "75\N{NO-BREAK SPACE}%")


def test_a_discrepancy_is_told_and_the_coverage_of_fits_without_one_is_not(run):
    impact = run.record | {"model": run.record["model"] | {"likelihood": "impact"}}
    plain, wider = (
        changed(run, record=impact | more) for more in ({}, {"discrepancy": {"rms_of_peak": 0.1}})
    )
    assert "discrepancy" in model_words.unused_priors(plain)
    assert "discrepancy" not in model_words.unused_priors(wider)
    assert "a smooth force of unknown shape" in model_words.likelihood_words(wider)
    assert "a smooth force" not in model_words.likelihood_words(plain)
    assert model_words.coverage_table(plain) is not None
    assert model_words.coverage_table(wider) is None


@pytest.mark.parametrize("alone", [False, True])
def test_where_one_tower_hits_several_pads_each_has_its_k_and_how_sure_it_is(run, alone) -> None:
    """Beside a discrepancy, where K is the element's alone, by the secant stiffness of each pad's impacts."""
    pads = pd.DataFrame({"factor": ["pad", "pad", "height"], "level": ["A", "B", "20"]})
    # Evenly spread draws, of which the 5 and 95 % points are known.
    drawn = np.linspace([29_890.0, 56_700.0], [30_110.0, 63_300.0], 2001)
    of_pads = xr.DataArray(drawn[None], {"pad": ["A", "B"]}, ("chain", "draw", "pad"))
    names = ("K_secant_of_pad", "K_secant_of_impacts") if alone else ("K_pad",)
    posterior = xr.Dataset(dict.fromkeys(names, of_pads))
    tower, people = (
        changed(run, levels=pads, groups={"posterior": posterior.assign_coords(subject=subjects)})
        for subjects in (["tower"], ["s1", "s2"])
    )
    values, sureness = answers.of_each_level(tower, "K")
    assert values == "A\N{NO-BREAK SPACE}30000, B\N{NO-BREAK SPACE}60000"
    # Half the interval of the least sure pad: ((60 + 0.9 * 3.3) / (60 - 0.9 * 3.3))^1/2 - 1.
    assert sureness.startswith("±5.1")
    assert answers.of_each_level(tower, "C") == ()
    # A typical one of several people is somebody.
    assert answers.of_each_level(people, "K") == ()
