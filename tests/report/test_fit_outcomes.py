"""The figures of what impacts do on the levels that are compared."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayestissue.reports.pages.fit import level_outcomes
from bayestissue.reports.pages.fit.fit_page import page_of
from make_fit_run import changed, fit_run


def test_the_pictures_numbers_are_those_of_the_tables() -> None:
    run = fit_run(two_sides=True)
    shown = level_outcomes.loops(run, "side").data
    assert set(shown["level"]) == {"left", "right"}
    assert {one.split(" at ")[0] for one in shown["panel"]} == {"0.4 kg", "0.7 kg", "1.2 kg"}
    assert np.allclose(shown["depth_mm"], 1e3 * run.loops["depth_m"])
    assert np.allclose(shown["force_N"], run.loops["force_N"])
    curve = level_outcomes.curves(run, "side").data
    of_force = run.curves[run.curves["quantity"] == "peak_force"]
    assert np.allclose(curve[["median", "low", "high"]], of_force[["median", "low", "high"]])
    ranked = level_outcomes.ranks(run, "side").data
    assert list(ranked["label"]) == ["right, rank 1", "left, rank 2"]
    depth = level_outcomes.ranks(run, "side", "peak_depth").data
    of_depth = run.levels[run.levels["quantity"] == "peak_depth"]
    assert np.allclose(sorted(depth["median"]), sorted(1e3 * of_depth["median"]))


def test_recorded_impacts_are_mass_times_deceleration_over_depth() -> None:
    run = fit_run(two_sides=True)
    chart = level_outcomes.loops(run, "side").chart
    recorded = chart["data"][chart["data"]["part"] == "recorded"]
    observed, impacts = run.groups["observed_data"], run.impacts_table.set_index("impact")
    for impact, rows in recorded.groupby("impact"):
        at = run.impacts.index(impact)
        assert rows["depth_mm"].max() == pytest.approx(1e3 * np.nanmax(observed["displacement"][at]))
        expected = impacts.loc[impact, "mass_kg"] * float(observed["deceleration"][at, 0])
        assert rows["force_N"].iloc[0] == pytest.approx(expected)
        assert set(rows["level"]) == {impacts.loc[impact, "side"]}


def test_where_impacts_are_many_the_page_has_the_recordings_of_some() -> None:
    which, run = [2, 7, 9], fit_run(two_sides=True)
    kept = ("observed_data", "posterior_predictive")
    run = changed(run, groups={name: run.posterior[name].to_dataset().isel(impact=which) for name in kept})
    assert page_of(run).rstrip().endswith("</html>")
    for figure in level_outcomes.loop_figures(run):
        drawn = json.dumps(figure.specification())
        assert [name for name in run.impacts if f'"{name}"' in drawn] == [run.impacts[at] for at in which]
