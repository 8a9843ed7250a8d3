"""Arrays filled up along one axis to one of a few lengths."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bayestissue.base.impact_arrays import bucket, padded_impacts, padded_rows, padded_zeros


def test_the_sizes_are_few_and_a_fourth_too_large_at_most() -> None:
    counts = np.arange(1, 5001)
    sizes = np.array([bucket(count) for count in counts])
    assert (sizes >= counts).all()
    assert (sizes <= 1.25 * counts).all()
    assert [bucket(size) for size in sizes] == sizes.tolist()
    assert len(set(sizes)) < 4 * np.log2(5000)


@pytest.mark.parametrize("impacts", [8, 9])
def test_what_is_added_is_the_first_once_more_or_nothing(impacts: int) -> None:
    values = np.random.default_rng(1).normal(size=(2, impacts, 33))
    more = bucket(impacts) - impacts
    assert_array_equal(padded_rows(impacts), [*range(impacts), *[0] * more])
    (copied,) = padded_impacts((values,), 1)
    assert copied.shape == (2, bucket(impacts), 33)
    assert_array_equal(copied[:, :impacts], values)
    assert_array_equal(copied[:, impacts:], np.repeat(values[:, :1], more, axis=1))
    assert padded_impacts(np.ones((2, 1, 3)), 1).shape == (2, 1, 3)
    (summed,) = padded_zeros((values,), -1)
    assert summed.shape == (2, impacts, bucket(33))
    assert_array_equal(summed[..., :33], values)
    assert_array_equal(summed[..., 33:], 0)
