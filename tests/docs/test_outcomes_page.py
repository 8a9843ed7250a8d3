"""The reference has every outcome of the program: its name, its column, its unit, a formula and a source."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bayestissue.elements.outcomes import HEADFORM_OUTCOMES
from bayestissue.inference.results.labels import element_attributes
from bayestissue.inference.results.meanings import HEADFORM_COLUMNS

PAGE = Path(__file__).parents[2] / "docs/reference/outcomes.md"


def rows() -> dict[str, list[str]]:
    """The cells behind the first of each row, by the name that stands there."""
    lines = re.findall(r"^\| (`.+?) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    cells = [[cell.strip() for cell in line.split(" | ")] for line in lines]
    return {name.strip("`"): rest for name, *rest in cells}


def test_there_is_no_row_of_an_outcome_that_the_program_does_not_have() -> None:
    assert set(rows()) == set(HEADFORM_OUTCOMES)


@pytest.mark.parametrize("name", HEADFORM_OUTCOMES)
def test_an_outcome_has_its_column_unit_formula_and_source(name: str) -> None:
    column, unit, formula, source = rows()[name]
    assert column == f"`{HEADFORM_COLUMNS[name]}`"
    assert unit.replace("³", "^3") == element_attributes()[name]["unit"]
    assert formula
    assert source
