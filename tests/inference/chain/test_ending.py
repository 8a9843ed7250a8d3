"""The rule that ends a run: perfect draws pass it, chains that disagree or are few do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from bayestissue.inference.chain.ending import FALSE_ALARMS, look, r_hat_limit


def draws(seed: int, quantities: int = 300, chains: int = 4, length: int = 500) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((quantities, chains, length))


@pytest.mark.slow
@pytest.mark.parametrize("length", [250, 500, 1000])
def test_independent_draws_pass_in_99_of_100_runs(length):
    # The third of a run's quantities are the population's, as in a small campaign.
    runs = 60
    failed = sum(
        not look(d[:100], d[100:], 300).passed for d in (draws(n, 300, 4, length) for n in range(runs))
    )
    # With a rate of FALSE_ALARMS more would fail once in ten thousand tests.
    assert failed <= binom.isf(1e-4, runs, FALSE_ALARMS)


def test_the_limit_is_of_a_run_and_not_of_a_quantity():
    assert r_hat_limit(1, 4, 1000) == 1.01
    assert r_hat_limit(2000, 4, 250) > r_hat_limit(100, 4, 250) > 1.01
    assert r_hat_limit(10**6, 4, 10**5) == 1.01


def test_a_chain_that_is_elsewhere_fails():
    apart = draws(1)
    apart[3, 0] += 0.5
    assert not look(apart[:100], apart[100:], 400).passed
    assert look(apart[:100], apart[100:], 400).slowest == 3


def test_impacts_may_be_slow_and_one_of_a_hundred_may_be_elsewhere():
    slow, one, some = draws(2), draws(2), draws(2)
    slow[200:, 0] += 0.25
    one[250, 0] += 1.5
    some[250:253, 0] += 1.5
    assert look(slow[:100], slow[100:], 100).passed
    assert look(one[:100], one[100:], 100).passed
    assert not look(some[:100], some[100:], 100).passed


def test_too_few_effective_draws_fail():
    steps = draws(3, 20, 4, 1000)
    slow = np.empty_like(steps)
    slow[..., 0] = steps[..., 0]
    for n in range(1, steps.shape[2]):
        slow[..., n] = 0.9 * slow[..., n - 1] + np.sqrt(1 - 0.81) * steps[..., n]
    verdict = look(slow[:10], slow[10:], 400)
    assert not verdict.passed
    assert verdict.effective < 400
