"""Rows in calls of one size are what one call of all of them would be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from jaxtyping import Array, Float

from bayestissue.inference.execution.compiling import by_row

SIZE = 8


@by_row(SIZE, constant=2)
def of_row(
    scale: float, offset: Any, row: Float[Array, " value"]
) -> tuple[Float[Array, ""], Float[Array, " value"]]:
    return row.sum(), scale * row + offset


@pytest.mark.parametrize("count", [1, 7, 8, 9, 50])
def test_the_calls_are_the_whole(count: int) -> None:
    rows = np.arange(9.0 * count).reshape(count, 9)
    total, moved = of_row(2.0, 1.0, rows)
    np.testing.assert_array_equal(total, rows.sum(1))
    np.testing.assert_array_equal(moved, 2 * rows + 1)


def test_rows_lie_along_as_many_axes_as_are_stated() -> None:
    def total(row: Float[Array, " value"]) -> Float[Array, ""]:
        return row.sum()

    rows = np.arange(2.0 * 5 * 9).reshape(2, 5, 9)
    np.testing.assert_array_equal(by_row(SIZE, constant=0, axes=2)(total)(rows), rows.sum(2))
