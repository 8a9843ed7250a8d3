"""Weights of points without any likelihood: no infinity is taken from another, and no warning is raised."""

from __future__ import annotations

import numpy as np
import pytest

from bayestissue.inference.samplers.sampling import k_threshold, pareto_smoothed


def test_draws_without_weight_get_none_and_leave_the_others_as_they_are() -> None:
    log_weight = np.random.default_rng(1).normal(size=1000)
    alone, k = pareto_smoothed(log_weight)
    among, k_among = pareto_smoothed(np.concatenate([log_weight, [-np.inf, np.nan, -np.inf]]))
    np.testing.assert_array_equal(among[:1000], alone)
    assert np.exp(among).sum() == pytest.approx(1.0)
    assert np.isneginf(among[1000:]).all()
    assert k_among == k < 0.7
    nothing, k = pareto_smoothed(np.full(10, -np.inf))
    assert np.exp(nothing).sum() == pytest.approx(1.0)
    assert k == np.inf


def test_the_limit_of_pareto_k_follows_the_number_of_draws() -> None:
    # Ten to the power of 10 / 3 draws and more bear 0.7 (Vehtari et al. 2024).
    assert [k_threshold(number) for number in (100, 1000, 2154, 2155, 10**6)] == pytest.approx(
        [0.5, 2 / 3, 0.7, 0.7, 0.7], abs=1e-4
    )
    # So few that nothing vouches for them.
    assert k_threshold(1) == k_threshold(10) == 0
