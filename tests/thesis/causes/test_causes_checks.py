from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayestissue.thesis.causes.verdict import JointCheck, attribute, confusion, reliability, two_sided


def campaigns(random: np.random.Generator, count: int) -> np.ndarray:
    """Three statistics that are neither normal nor independent."""
    a = random.standard_normal(count)
    return np.column_stack([a, np.exp(a + 0.3 * random.standard_normal(count)), random.gamma(2, size=count)])


def test_p_values_of_the_cause_itself_are_uniform() -> None:
    random = np.random.default_rng(0)
    joint, single = [], []
    for _ in range(200):
        own = campaigns(random, 121)
        joint.append(JointCheck(own[1:]).p_value(own[0]))
        single.append(two_sided(own[1:, 1], own[0, 1]))
    # Under uniformity 1 in 1000 such tests fail.
    assert stats.kstest(joint, "uniform").pvalue > 1e-3
    assert stats.kstest(single, "uniform").pvalue > 1e-3


def test_a_campaign_off_the_joint_distribution_is_found_where_each_number_is_usual() -> None:
    random = np.random.default_rng(1)
    a = random.standard_normal(2000)
    own = np.column_stack([a, a + 0.3 * random.standard_normal(2000)])
    odd = np.array([1.5, -1.5])
    assert min(two_sided(own[:, k], odd[k]) for k in range(2)) > 0.05
    check = JointCheck(own)
    assert check.p_value(odd) == pytest.approx(check.smallest_p)


def test_campaigns_without_all_statistics_are_left_out() -> None:
    own = campaigns(np.random.default_rng(2), 400)
    own[::3, 1] = np.nan
    check = JointCheck(own)
    assert 0 < check.p_value(np.array([0.0, 1.0, 2.0])) <= 1
    assert two_sided(own[:, 1], 1.0) > 0.5
    with pytest.raises(ValueError, match="campaigns with all statistics"):
        JointCheck(own[:24])


@pytest.mark.slow
def test_the_posterior_of_two_normals_is_bayes_theorem() -> None:
    random = np.random.default_rng(3)
    cause = np.arange(600) % 2
    values = random.standard_normal((len(cause), 2)) + np.column_stack([1.5 * cause, 0 * cause])
    observed = np.array([1.1, 0.0])
    odds = np.exp(stats.norm.logpdf(1.1, 1.5) - stats.norm.logpdf(1.1))
    found = attribute(values, cause, observed, seed=0)
    assert found.probability.sum() == pytest.approx(1)
    # Four Monte Carlo errors; a network of finite size adds its own.
    assert found.probability[1] == pytest.approx(odds / (1 + odds), abs=4 * found.error[1] + 0.03)
    told = reliability(found)
    share = told[:, 1]
    error = np.sqrt(np.maximum(share * (1 - share), 0.01) / told[:, 2])
    assert np.all(np.abs(told[:, 0] - share) < 4 * error + 0.03)
    table = confusion(found)
    np.testing.assert_allclose(table.sum(axis=1), 1)
    assert table[0, 0] > 0.6 < table[1, 1]
