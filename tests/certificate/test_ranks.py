"""Ranks of truths: uniform ones pass as often as they should, and each fault of intervals is found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from bayestissue.studies.certificate.ranks import DRAWS, calibration_table, half_band, judge, p_of_uniform

REFITS = 20


def ranks_of(
    rng: np.random.Generator, shape: tuple[int, ...], *, sd: float = 1.0, shift: float = 0.0
) -> np.ndarray:
    """Of truths that posteriors of unit width have too narrow, or beside them."""
    places = norm.cdf(shift + sd * rng.standard_normal(shape))
    return np.minimum((places * (DRAWS + 1)).astype(int), DRAWS)


def test_p_of_uniform_ranks_is_uniform() -> None:
    rng = np.random.default_rng(0)
    p = np.array([p_of_uniform(rng.integers(0, DRAWS + 1, REFITS)) for _ in range(500)])
    for level in (0.01, 0.1, 0.5):
        # A share of 2000; the statistic has few values, so that it may be a little rarer.
        assert (p <= level).mean() <= level + 4 * np.sqrt(level * (1 - level) / len(p))
        assert (p <= level).mean() >= 0.5 * level


def test_a_share_of_ranks_beyond_the_band_is_hardly_ever_uniform() -> None:
    band = half_band(REFITS)
    # Of one place alone it would be 1.96 standard errors; of a curve's 99 places it is some more.
    assert 1.96 < 2 * np.sqrt(REFITS) * band < 3.3
    low = int(np.ceil(REFITS * (0.5 + band))) + 1
    places = np.r_[np.linspace(0, 0.49, low), np.linspace(0.51, 1, REFITS - low)]
    assert p_of_uniform((places * DRAWS).astype(int)) <= 0.05


def test_elements_of_one_refit_count_as_dependent() -> None:
    rng = np.random.default_rng(1)
    small = 0
    for _ in range(100):
        common = rng.standard_normal((REFITS, 1))
        places = norm.cdf(0.8 * common + 0.6 * rng.standard_normal((REFITS, 50)))
        small += judge("K", (places * (DRAWS + 1)).astype(int))["p"] < 0.05
    assert small / 100 < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 100)


@pytest.mark.parametrize(("sd", "shift"), [(1.3, 0.0), (0.7, 0.0), (1.0, 0.3)])
def test_wrong_intervals_of_impacts_are_found(sd: float, shift: float) -> None:
    rng = np.random.default_rng(2)
    right = {f"right {number}": ranks_of(rng, (REFITS, 1)) for number in range(10)}
    wrong = {"wrong": ranks_of(rng, (REFITS, 90), sd=sd, shift=shift)}
    table = calibration_table(
        [{name: rows[n] for name, rows in (right | wrong).items()} for n in range(REFITS)]
    )
    assert table.loc[table["passed"] == 0, "quantity"].tolist() == ["wrong"]
    row = table.set_index("quantity").loc["wrong"]
    assert row["held"] == pytest.approx(
        1 - 2 * norm.sf((1.6449 - shift) / sd) if not shift else 0.884, abs=0.02
    )
    assert row["shift"] == pytest.approx(shift, abs=0.1)
