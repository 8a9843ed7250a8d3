"""Each room of src keeps to its budget, ``[tool.house]`` of pyproject.toml."""

import runpy
from pathlib import Path

import pytest

HOUSE = runpy.run_path(str(Path(__file__).parents[1] / "tools" / "house.py"))


@pytest.fixture(scope="module")
def now() -> dict[str, dict[str, int]]:
    return HOUSE["sizes"]()


def test_no_room_is_above_its_budget(now: dict[str, dict[str, int]]) -> None:
    """A room that grew: take as much away, or say in the commit why it has more, and lower another."""
    assert HOUSE["excesses"](now, HOUSE["budget"]()) == []


def test_every_budget_is_of_a_room(now: dict[str, dict[str, int]]) -> None:
    """One of a folder that is gone leaves the table: python tools/house.py --lower."""
    assert set(HOUSE["budget"]()) <= set(now)
