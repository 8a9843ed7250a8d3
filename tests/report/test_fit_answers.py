"""Numbers of the page of a fit, against what they are made from."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
import xarray as xr

from bayestissue import Fit
from bayestissue.reports.pages.fit import answers, checks, method_agreement, trace_predictions
from bayestissue.reports.pages.fit.method_agreement import apparent_exponent
from make_fit_run import changed, fit_run


def test_intervals_that_hold_the_truth_and_the_ratio_of_the_methods_are_counted():
    run, expected = fit_run(), []
    for q, column in (("K", "K_N_per_m"), ("C", "C_N_s_per_m")):
        rows = run.summary.query("variable == @q").set_index("label").loc[run.truth["impact"]]
        true = run.truth[column].to_numpy()
        ends = ((level, rows[f"eti{level}_low"], rows[f"eti{level}_high"]) for level in (50, 90))
        expected += [(q, level, ((low < true) & (true < high)).sum(), 12) for level, low, high in ends]
        ratio = np.median(run.point_estimates[column].to_numpy() / rows["median"])
        assert method_agreement.dds_ratio(run, q) == pytest.approx(ratio)
    assert [tuple(row) for row in method_agreement.held_by_intervals(run).to_numpy()] == expected


def test_the_apparent_exponent_is_the_line_of_least_squares_with_its_interval():
    run = fit_run()
    found, table = apparent_exponent(run, "K"), run.point_estimates
    x = np.log(table["mass_kg"] / run.reference_mass)
    fitted = sm.OLS(np.log(table["K_N_per_m"]), sm.add_constant(x.to_numpy())).fit()
    expected = [*fitted.params, *fitted.conf_int(alpha=0.1).iloc[1]]
    told = [found.intercept, found.slope.median, found.slope.low, found.slope.high]
    np.testing.assert_allclose(told, expected, rtol=1e-9, atol=1e-12)


def test_side_by_side_is_held_against_the_other_element_s_secant_stiffness():
    true = fit_run().truth
    run = changed(fit_run(), truth=true.assign(K_secant_N_per_m=2 * true["K_N_per_m"]))
    other = changed(run, record={"model": {"element": "maxwell"}})
    np.testing.assert_array_equal(run.estimates_by_method["K"]["truth"], 2 * true["K_N_per_m"])
    np.testing.assert_array_equal(run.estimates_by_method["C"]["truth"], true["C_N_s_per_m"])
    np.testing.assert_array_equal(other.estimates_by_method["K"]["truth"], true["K_N_per_m"])


def test_the_recording_shown_first_is_that_of_the_median_stiffness():
    run = fit_run()
    level = run.of_impacts("K")["median"].to_numpy()
    place = trace_predictions.middle_impact(run)
    assert (level < level[place]).sum() == len(level) // 2
    rows = trace_predictions.trace_rows(run, place)
    recorded = run.groups["observed_data"][run.shown].to_numpy()[place]
    np.testing.assert_array_equal(rows["recorded"], recorded[np.isfinite(recorded)])
    bands = rows[["low", "quarter", "median", "three_quarters", "high"]].to_numpy()
    assert np.all(np.diff(bands, axis=1) >= 0)


def test_coverage_is_shown_once_it_was_measured(tmp_path, monkeypatch):
    path = tmp_path / "coverage.csv"
    path.write_text("likelihood,quantity,level,held,impacts,command,measured\n", encoding="utf-8")
    monkeypatch.setattr(checks, "_MEASURED", path)
    assert checks.coverage_table(fit_run()) is None
    with path.open("a", encoding="utf-8") as stream:
        stream.write("impact,K,90,1500,2000,a command,on an earlier version\narma,K,90,1,2,another,\n")
    (row,) = checks.coverage_table(fit_run()).rows
    # When and by which program it was measured is no concern of a lab's.
    assert row.cells == ("K", "90 %", "1500 of 2000", "75\N{NO-BREAK SPACE}%")


@pytest.mark.parametrize("alone", [False, True])
def test_where_one_tower_hits_several_pads_each_has_its_k_and_how_sure_it_is(alone) -> None:
    """Beside a discrepancy, where K is the element's alone, by the secant stiffness of each pad's impacts."""
    pads = pd.DataFrame({"factor": ["pad", "pad", "height"], "level": ["A", "B", "20"]})
    # Evenly spread draws, of which the 5 and 95 % points are known.
    drawn = np.linspace([29_890.0, 56_700.0], [30_110.0, 63_300.0], 2001)
    of_pads = xr.DataArray(drawn[None], {"pad": ["A", "B"]}, ("chain", "draw", "pad"))
    names = ("K_secant_of_pad", "K_secant_of_impacts") if alone else ("K_pad",)

    def of(subjects: list[str]) -> Fit:
        run = changed(fit_run(), levels=pads)
        run.groups["posterior"] = xr.Dataset(dict.fromkeys(names, of_pads), {"subject": subjects})
        return run

    values, sureness = answers.of_each_level(of(["tower"]), "K")
    assert values == "A\N{NO-BREAK SPACE}30000, B\N{NO-BREAK SPACE}60000"
    # Half the interval of the least sure pad: ((60 + 0.9 * 3.3) / (60 - 0.9 * 3.3))^1/2 - 1.
    assert sureness.startswith("±5.1")
    assert answers.of_each_level(of(["tower"]), "C") == ()
    # A typical one of several people is somebody.
    assert answers.of_each_level(of(["s1", "s2"]), "K") == ()
