"""Estimates beside the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm

from bayestissue.reports.pages.fit.method_agreement import apparent_exponent
from make_fit_run import make_fit_run, read_fit_run

pytestmark = pytest.mark.usefixtures("read_once")


def test_side_by_side_is_held_against_the_other_element_s_secant_stiffness(
    tmp_path: Path,
) -> None:
    folder = make_fit_run(tmp_path / "run")
    about = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    path = folder / "truth.csv"
    truth = pd.read_csv(path)
    truth.assign(K_secant_N_per_m=2 * truth["K_N_per_m"]).to_csv(path, index=False)
    run = read_fit_run(folder, about)
    np.testing.assert_array_equal(run.estimates_by_method["K"]["truth"], 2 * truth["K_N_per_m"])
    np.testing.assert_array_equal(run.estimates_by_method["C"]["truth"], truth["C_N_s_per_m"])
    about["model"]["element"] = "maxwell"
    np.testing.assert_array_equal(
        read_fit_run(folder, about).estimates_by_method["K"]["truth"], truth["K_N_per_m"]
    )


def test_the_apparent_exponent_is_the_line_of_least_squares_with_its_interval(tmp_path: Path) -> None:
    folder = make_fit_run(tmp_path / "run")
    run = read_fit_run(folder, json.loads((folder / "run.json").read_text(encoding="utf-8")))
    found = apparent_exponent(run, "K")
    assert found is not None
    table = run.point_estimates
    x = np.log(table["mass_kg"] / run.reference_mass)
    fitted = sm.OLS(np.log(table["K_N_per_m"]), sm.add_constant(x.to_numpy())).fit()
    expected = [*fitted.params, *fitted.conf_int(alpha=0.1).iloc[1]]
    told = [found.intercept, found.slope.median, found.slope.low, found.slope.high]
    np.testing.assert_allclose(told, expected, rtol=1e-9, atol=1e-12)
