"""Rows in calls of one size are what one call of all of them would be."""

from __future__ import annotations

import pickle
from importlib import import_module
from pkgutil import walk_packages
from typing import Any

import numpy as np
import pytest
from jaxtyping import Array, Float

import bayestissue
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


def test_any_number_of_rows_is_compiled_once() -> None:
    before = of_row.jitted._cache_size()
    for count in (3, SIZE, 21):
        assert of_row(7.0, 1.0, np.ones((count, 11)))[1].shape == (count, 11)
    assert of_row.jitted._cache_size() == before + 1


def test_what_is_compiled_is_found_by_its_name() -> None:
    """Otherwise no function that calls it can be sent to another process."""
    packages = [each.name for each in walk_packages(bayestissue.__path__, "bayestissue.") if not each.ispkg]
    modules = [import_module(name) for name in packages if ".inference." in name]
    by_name = {
        f"{module.__name__}.{name}": value
        for module in modules
        for name, value in vars(module).items()
        if hasattr(value, "jitted")
    }
    lost = [name for name, value in by_name.items() if pickle.loads(pickle.dumps(value)) is not value]  # noqa: S301
    assert len(by_name) > 5
    assert lost == []
