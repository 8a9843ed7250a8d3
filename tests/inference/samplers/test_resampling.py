"""Draws are taken as often as their weights say, each chain by itself."""

from __future__ import annotations

import numpy as np
import pytest

from bayestissue.inference.samplers.psis import systematic


def test_a_chain_without_weight_stays_as_it_is() -> None:
    weight = np.array([[0.0, 2.0, 0.0, 2.0], [0.0, 0.0, 0.0, 0.0]])
    chosen = systematic(weight, 4, np.random.default_rng(0))
    np.testing.assert_array_equal(chosen, [[1, 1, 3, 3], [0, 1, 2, 3]])


@pytest.mark.parametrize("number", [10, 50, 100])
def test_draws_are_chosen_as_often_as_their_weights_say(number: int) -> None:
    rng = np.random.default_rng(4)
    weight = rng.gamma(0.5, size=(3, 100))
    for chain, places in enumerate(systematic(weight, number, rng)):
        times = np.bincount(places, minlength=100)
        wanted = number * weight[chain] / weight[chain].sum()
        # Systematic resampling is never off by one whole draw, and keeps the chain's order.
        assert (np.abs(times - wanted) < 1).all()
        assert (np.diff(places) >= 0).all()
