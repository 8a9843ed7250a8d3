from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.inference.answers.reliability import agreement


def test_limits_hold_the_ratio_of_95_of_100_impacts() -> None:
    rng, n = np.random.default_rng(1), 4000
    truth = 2000 * np.exp(0.3 * rng.standard_normal(n))
    table = pd.DataFrame({"dds": 2 * truth * np.exp(0.1 * rng.standard_normal(n)), "posterior": truth})
    table.loc[:9, "dds"] = [-1.0, np.nan, *[0.0] * 8]
    (row,) = agreement({"K": table}).to_dict("records")
    assert (row["impacts"], row["left_out"]) == (n - 10, 10)
    assert row["ratio"] == pytest.approx(2, rel=3 * 0.1 / np.sqrt(n))
    held = (table["dds"] / table["posterior"]).iloc[10:].between(row["low"], row["high"]).mean()
    assert held == pytest.approx(0.95, abs=3 * np.sqrt(0.95 * 0.05 / n))


def test_one_impact_has_a_ratio_and_no_limits() -> None:
    found = agreement({"C": pd.DataFrame({"dds": [2.0, 2.0], "posterior": [1.0, -1.0]})})
    assert found["ratio"][0] == pytest.approx(2)
    assert found["low"].isna().all()
    assert found["impacts"].tolist() == [1]
