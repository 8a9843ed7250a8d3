from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from bayestissue.inference.checking.measuring_chain import ALL, IMPACT, RATE, alarmed, alarms, pattern_of

PEOPLE, CONDITIONS = 4, 5
GROUPS = {
    "trial": np.repeat(np.arange(CONDITIONS), PEOPLE),
    "subject": np.tile(np.arange(PEOPLE), CONDITIONS),
}
COUNT = PEOPLE * CONDITIONS


@pytest.mark.slow
def test_right_models_raise_alarms_as_seldom_as_promised() -> None:
    rng = np.random.default_rng(3)
    sets = 4000
    raised = sum(alarmed(z, GROUPS) for z in rng.standard_normal((sets, COUNT)))
    # Bonferroni's inequality bounds the rate; a count beyond this has a probability of 1 in 10,000.
    assert raised <= binom.isf(1e-4, sets, RATE)
    assert raised > 0


def found(z: np.ndarray):
    return pattern_of(z, np.ones(COUNT), np.ones(COUNT), GROUPS)


@pytest.fixture(name="z")
def _z() -> np.ndarray:
    return np.random.default_rng(5).standard_normal(COUNT)


def test_all_shifted_by_two_though_none_alone_is_incredible(z: np.ndarray) -> None:
    shifted = z + 2
    assert not alarms(shifted, GROUPS)[IMPACT].any()
    pattern = found(shifted)
    assert (pattern.kind, pattern.common, pattern.impacts.all()) == (ALL, True, True)


@pytest.mark.parametrize(("kind", "which"), [("trial", 2), ("subject", 1)])
def test_a_group_is_named(z: np.ndarray, kind: str, which: int) -> None:
    concerned = GROUPS[kind] == which
    pattern = found(z + 6 * concerned)
    assert (pattern.kind, pattern.common) == (kind, True)
    assert (pattern.impacts == concerned).all()


def test_one_impact_of_twenty_is_named(z: np.ndarray) -> None:
    z[7] = 9.0
    pattern = found(z)
    assert pattern.kind == IMPACT
    assert np.flatnonzero(pattern.impacts).tolist() == [7]


def test_a_wide_scatter_without_a_direction_is_that_of_all() -> None:
    pattern = found(2.4 * np.random.default_rng(7).permutation(np.tile([1, -1], COUNT // 2)))
    assert (pattern.kind, pattern.common) == (ALL, False)


def test_a_small_shift_of_very_many_is_no_alarm() -> None:
    z = np.random.default_rng(6).standard_normal(100_000) + 0.1
    assert not alarmed(z, {})
