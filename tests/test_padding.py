"""Arrays filled up along their named axes: nothing is found of what was added."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from jaxtyping import Array, Float
from numpy.testing import assert_array_equal

from bayestissue.padding import adds_nothing, bucket, cut, padded, sizes_of


class Record(NamedTuple):
    x: Float[Array, "impact sample"]
    lanes: tuple[Float[Array, "block impact lane"], ...]
    absent: Float[Array, " impact"] | None = None


@adds_nothing
class Sums(NamedTuple):
    level: Float[Array, " impact"]


def test_the_sizes_are_few_and_a_fourth_too_large_at_most() -> None:
    counts = np.arange(1, 5001)
    sizes = np.array([bucket(count) for count in counts])
    assert (sizes >= counts).all()
    assert (sizes <= 1.25 * counts).all()
    assert [bucket(size) for size in sizes] == sizes.tolist()
    assert len(set(sizes)) < 4 * np.log2(5000)


@pytest.mark.parametrize("impacts", [8, 9])
def test_what_is_filled_up_is_cut_again(impacts: int) -> None:
    rng = np.random.default_rng(1)
    given = (
        Record(rng.normal(size=(impacts, 33)), (rng.normal(size=(2, impacts, 5)),)),
        Sums(np.ones(impacts)),
    )
    sizes = sizes_of(given, (None, None))
    assert sizes == {"impact": impacts, "sample": 33}
    record, sums = filled = tuple(padded(part, None, sizes) for part in given)
    assert record.x.shape == (bucket(impacts), bucket(33))
    assert record.lanes[0].shape == (2, bucket(impacts), 5)
    assert record.absent is None
    # Another impact is the first once more, but adds nothing to a sum; another sample is 0.
    assert_array_equal(record.x[impacts:, :33], np.repeat(given[0].x[:1], bucket(impacts) - impacts, axis=0))
    assert_array_equal(record.x[:, 33:], 0)
    assert sums.level.sum() == impacts
    for part, whole in zip(given, filled, strict=True):
        again = cut(whole, None, sizes)
        assert_array_equal(again[0], part[0])


def test_annotations_of_arguments_name_axes_too() -> None:
    draws = np.ones((4, 9, 2))
    annotation = dict[str, Float[Array, "draw impact ..."]]
    sizes = sizes_of(({"K": draws},), (annotation,))
    assert sizes == {"impact": 9}
    found = padded({"K": draws}, annotation, sizes)
    assert found["K"].shape == (4, bucket(9), 2)
    assert cut(found, annotation, sizes)["K"].shape == draws.shape
    behind = Float[Array, "*batch impact parameter"]
    assert padded(draws, behind, {"impact": 9}).shape == (4, bucket(9), 2)


def test_an_axis_of_one_that_broadcasts_stays_so() -> None:
    annotation = Float[Array, "block #impact lane"]
    assert padded(np.ones((2, 1, 3)), annotation, {"impact": 9}).shape == (2, 1, 3)
