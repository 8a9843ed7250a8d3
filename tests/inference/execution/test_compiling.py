"""Rows in calls of one size are what one call of all of them would be."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from bayestissue.inference.execution.compiling import first_rows, in_calls

SIZE = 8


@pytest.mark.parametrize("count", [1, 7, 8, 9, 50])
def test_the_calls_are_the_whole(count: int) -> None:
    rows = np.arange(3.0 * count).reshape(count, 3)
    sizes: list[tuple[int, int]] = []

    def function(rows: Any, number: int) -> dict[str, Any]:
        sizes.append((len(rows), number))
        return first_rows(lambda place: {"sum": rows[place].sum(), "rows": rows[place]}, SIZE, number)

    found = in_calls(lambda rows, number: function(jnp.asarray(rows), number), (rows,), SIZE)
    np.testing.assert_array_equal(found["sum"], rows.sum(1))
    np.testing.assert_array_equal(found["rows"], rows)
    assert {length for length, _ in sizes} == {SIZE}
    assert sum(number for _, number in sizes) == count
