"""Names and categories that are written in two ways, or in none, in the table of impacts."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.dataset.impacts import impact_table
from bayestissue.hierarchy.formulas.formula import judge


def table(**columns: list[str]):
    cells = {"impact": list("abcd"), "subject": ["s1", "s1", "s2", "s2"], "trial": ["x", "y"] * 2}
    cells |= {"mass_kg": ["0.5", "1"] * 2, "velocity_m_s": ["1"] * 4}
    return impact_table(pd.DataFrame(cells | columns), np.arange(2, 6), needs_velocity=True)


@pytest.mark.parametrize(
    ("column", "values", "row"),
    [
        ("subject", ["s1", "S1", "s2", "s2"], 3),
        ("trial", ["x", "y", "x ", "y"], 4),
        ("side", ["left", "Left", "right", "right"], 3),
        ("side", ["left", "left ", "right", "right"], 3),
        ("braced", ["yes", "Yes", "no", "no"], 3),
        ("pad", ["PU-1", "PU 1", "PU-2", "PU-2"], 3),
    ],
)
def test_two_ways_to_write_a_name_are_a_warning_in_every_column(column, values, row):
    (found,) = table(**{column: values}).warnings
    assert (found.row, found.column, found.code) == (row, column, "two-spellings")


def test_names_that_differ_and_recordings_are_no_two_ways():
    assert not table(side=["left", "right"] * 2, trace=["A.csv", "a.csv", "b.csv", "c.csv"]).warnings


@pytest.mark.parametrize("formula", ["side", "(1|side)", "C(side) + log(mass_kg)", "mass_kg:side"])
def test_an_empty_cell_is_no_category_where_a_formula_uses_it(formula):
    read = table(side=["left", "", "right", "right"])
    (warned,) = read.warnings
    assert (warned.row, warned.column) == (3, "side")
    reasons = " ".join(fault.reason for fault in judge(formula, read.table, 1.0).faults)
    assert "side is missing in 1 of 4 impacts, such as impact b" in reasons
    assert not any("side" in fault.reason for fault in judge("log(mass_kg)", read.table, 1.0).faults)
