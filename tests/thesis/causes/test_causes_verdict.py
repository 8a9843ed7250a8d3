from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from causes_bench import specification

from bayestissue.thesis.causes import verdict as tables
from bayestissue.thesis.causes.verdict import Verdict, judge

pytestmark = pytest.mark.slow

CAUSES = ("none", "centring", "own_time")
OBSERVED = {
    "mass_exponent_K": 1.0,
    "K_over_M_scatter": 0.05,
    "zeta_median": 0.3,
    "K_over_M_mean": 24.0,
    "without_estimate": 0.0,
}


def campaigns(count: int = 200) -> pd.DataFrame:
    """Fixed tissue with exponent 0, centring with 0.3 and hardly ever a complete table, own time with 1."""
    random = np.random.default_rng(0)
    tables = []
    for cause, exponent in zip(CAUSES, (0.0, 0.3, 1.0), strict=True):
        table = pd.DataFrame(
            {
                "mass_exponent_K": exponent + 0.1 * random.standard_normal(count),
                "K_over_M_scatter": np.exp(-3 + 0.5 * random.standard_normal(count)),
                "zeta_median": np.exp(-1.2 + 0.3 * random.standard_normal(count)),
                "K_over_M_mean": np.exp(8 + random.standard_normal(count)),
                "without_estimate": 0.0,
            }
        )
        if cause == "centring":
            table.loc[5:, "zeta_median"] = np.nan
        strength = random.uniform(1, 2, count) if cause == "own_time" else np.nan
        tables.append(
            table.assign(
                cause=cause, batch=0, campaign=np.arange(count), strength_window_over_time_to_peak=strength
            )
        )
    return pd.concat(tables, ignore_index=True)


def judged(*, level_known: bool) -> Verdict:
    """With fewer networks than a run has: their answer is tested by itself."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "SETTINGS", replace(tables.SETTINGS, networks=1))
        return judge(campaigns(), OBSERVED, specification(*CAUSES), level_known=level_known, seed=0)


@pytest.fixture(scope="module")
def verdict() -> Verdict:
    return judged(level_known=False)


def test_one_row_a_cause_in_the_order_of_the_file(verdict: Verdict) -> None:
    causes = verdict.causes.set_index("cause")
    assert list(causes.index) == list(CAUSES)
    assert causes["probability"].sum() == pytest.approx(1)
    assert causes.loc["own_time", "probability"] > 0.95
    assert list(causes["verdict"]) == ["refuted", "doubtful", "possible"]
    assert causes.loc["none", "fails"] == "mass_exponent_K"
    assert causes.loc["own_time", "nearest"].startswith("window_over_time_to_peak 1.")
    assert causes.loc["none", "nearest"] == ""


def test_a_cause_that_hardly_ever_gives_a_whole_table_is_judged_by_that(verdict: Verdict) -> None:
    row = verdict.causes.set_index("cause").loc["centring"]
    assert row["complete"] == pytest.approx(5 / 200)
    assert row["p_joint"] == pytest.approx(6 / 201)
    assert row["fails"] == "without_estimate"
    assert row["probability"] < 0.05


def test_the_size_of_k_is_told_but_not_compared_where_its_unit_is_unknown(verdict: Verdict) -> None:
    compared = verdict.observed.set_index("statistic")["compared"]
    assert compared["K_over_M_mean"] == "no"
    assert verdict.causes["p_K_over_M_mean"].max() < 0.02
    known = judged(level_known=True)
    assert known.causes["verdict"].tolist()[2] == "refuted"


def test_tables_for_the_page(verdict: Verdict) -> None:
    np.testing.assert_allclose(verdict.confusion[list(CAUSES)].sum(axis=1), 1)
    assert verdict.confusion["none"][0] > 0.9
    rows = verdict.predictive[verdict.predictive["statistic"] == "mass_exponent_K"].set_index("cause")
    # The median of 200 has a standard error of 1.25 * 0.1 / sqrt(200).
    np.testing.assert_allclose(rows["q50"], (0, 0.3, 1), atol=4 * 0.009)
    assert verdict.log_score[0] > verdict.log_score[1] == pytest.approx(-np.log(3))
