from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.claims import deviation_of_largest, largest, smallest
from bayestissue.thesis.reproduction.conditions import conditions


@given(values=arrays(float, st.integers(2, 12), elements=st.floats(-50, 50)))
def test_the_largest_lies_within_its_bounds(values: np.ndarray) -> None:
    n, spread = len(values), float(np.ptp(values))
    low, high = deviation_of_largest(float(np.std(values, ddof=1)), spread, n)
    deviation = values.max() - values.mean()
    # a square root of a difference of squares near 2500 n is good to 1e-6
    assert low - 1e-5 <= deviation <= high + 1e-5


def test_printed_numbers_that_exclude_each_other_fall_back_to_the_range() -> None:
    assert deviation_of_largest(sd=0.0, spread=1.0, n=10) == (0.1, 0.9)


def test_what_the_remaining_impacts_decide(published: PublishedTables) -> None:
    k, c = conditions(published, "K"), conditions(published, "C")
    assert (smallest(k).decided, smallest(k).low) == (True, 8.832)
    assert (smallest(c).decided, smallest(c).low) == (True, 0.121)
    # hand figure: 2.5 d² - 2.5 R d + 1.125 R² = 9 s² with R = 0.674, s = 0.2085 gives d = 0.0799 and 0.594
    assert largest(k).low == pytest.approx(31.631 + 0.0799 - 0.0005, abs=1e-3)
    assert largest(k).high == pytest.approx(31.631 + 0.594 + 0.0005, abs=1e-3)
    assert largest(c).low == 4.029
    assert not largest(c).decided
