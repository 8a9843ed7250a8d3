"""The reference has every outcome of the program: its name, its column, its unit, a formula and a source."""

from __future__ import annotations

from pathlib import Path

import pytest

from bayestissue.mechanics.elements import Outcomes
from bayestissue.mechanics.elements.outcomes import DECLARED

PAGE = Path(__file__).parents[2] / "docs/reference/outcomes.md"


def test_the_page_has_all_that_is_declared() -> None:
    assert "from the program: outcomes.*" in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", DECLARED)
def test_an_outcome_has_its_number_column_unit_formula_and_source(name: str) -> None:
    one = DECLARED[name]
    assert hasattr(Outcomes, name)
    unit = one.unit.translate(str.maketrans({"/": "_", " ": "_", "^": ""}))
    assert one.column.endswith(unit if unit != "1" else name)
    assert one.formula
    assert one.source
