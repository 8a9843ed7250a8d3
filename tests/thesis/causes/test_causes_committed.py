"""What the committed test of the published numbers says of the test itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

REPORT = Path(__file__).resolve().parents[3] / "docs" / "reports" / "causes"


@pytest.fixture(scope="module")
def confusion() -> pd.DataFrame:
    return pd.read_csv(REPORT / "confusion.csv").set_index("truth")


def test_campaigns_are_attributed_to_their_cause_or_to_one_like_it(confusion: pd.DataFrame) -> None:
    for truth, row in confusion.iterrows():
        assert row.idxmax() == truth or row[truth] > 0.9 * row.max()
        # One way is enough: a cause whose campaigns are complete in a third gets as much less from others.
        alike = [other for other in row.index if row[other] > 0.2]
        assert row[[*{truth, *alike}]].sum() > 0.75


def test_probabilities_are_right_as_often_as_they_say() -> None:
    told = pd.read_csv(REPORT / "reliability.csv")
    error = np.sqrt(told["probability"] * (1 - told["probability"]) / told["cases"])
    # Four standard errors, and what a dozen calibrated numbers share.
    assert np.all(np.abs(told["probability"] - told["right"]) < 4 * error + 0.01)


def test_p_values_are_uniform_under_their_own_cause() -> None:
    causes = pd.read_csv(REPORT / "causes.csv")
    for share, column in ((0.1, "calibration_below_10"), (0.5, "calibration_below_50")):
        # Both the ranked and the tried half are random.
        error = np.sqrt(2 * share * (1 - share) / causes["calibration_campaigns"])
        assert np.all(np.abs(causes[column] - share) < 4 * error)
    # The smallest of so many p-values.
    assert causes["calibration_p"].min() > 0.01 / len(causes)
