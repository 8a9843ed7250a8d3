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


def test_an_excess_names_the_room_and_by_how_much_it_grew(tmp_path: Path) -> None:
    (tmp_path / "signal").mkdir()
    text = '"""A module."""\n\nimport math\n\n# why\n\n\ndef f(x):\n    """Twice."""\n    return 2 * x\n'
    (tmp_path / "signal" / "twice.py").write_text(text)
    (tmp_path / "alone.py").write_text("X = 1\n")
    now = HOUSE["sizes"](tmp_path)
    assert now["signal"]["lines"] == 2
    assert now["signal"]["functions"] == now["signal"]["modules"] == now["top"]["lines"] == 1
    most = {"signal": {**now["signal"], "lines": 1}, "top": now["top"]}
    assert HOUSE["excesses"](now, most) == ["signal has 2 lines, 1 above its budget"]
    assert len(HOUSE["excesses"](now, {"top": now["top"]})) == 4


@pytest.mark.parametrize("what", ["lines", "modules", "functions", "nodes"])
def test_each_room_is_held_to_each_number(what: str) -> None:
    assert all(what in most for most in HOUSE["budget"]().values())
