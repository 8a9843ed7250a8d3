"""Names and categories that are written in two ways, or in none, in the table of impacts."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.model.hierarchy.formulas.formula import resolve
from bayestissue.recordings.dataset.cells import standard_names
from bayestissue.recordings.dataset.impact_table import COLUMNS, impact_table
from cases import cases
from dataset_bench import SETTINGS, Lab, tables


def table(**columns: list[str]):
    cells = {"impact": list("abcd"), "subject": ["s1", "s1", "s2", "s2"], "trial": ["x", "y"] * 2}
    cells |= {"mass_kg": ["0.5", "1"] * 2, "velocity_m_s": ["1"] * 4}
    return impact_table(pd.DataFrame(cells | columns), np.arange(2, 6), needs_velocity=True)


@pytest.mark.parametrize(("column", "values", "row"), cases(__file__, "two_ways"))
def test_two_ways_to_write_a_name_are_a_warning_in_every_column(column, values, row):
    (found,) = table(**{column: values}).warnings
    assert (found.row, found.column, found.code) == (row, column, "two-spellings")


@pytest.mark.parametrize("names", cases(__file__, "different"))
def test_names_that_differ_and_recordings_are_no_two_ways(names):
    assert not table(subject=names, trial=names, trace=["A.csv", "a.csv", "b.csv", "c.csv"]).warnings


@pytest.fixture
def holed(lab: Lab) -> Lab:
    """A dataset with three empty cells: two of a category, one of a number."""
    for row, column in ((3, "sex"), (5, "sex"), (4, "skinfold_mm")):
        lab.cell("impacts.csv", row, column, "")
    return lab


PLACES = [(5, "sex"), (3, "sex"), (4, "skinfold_mm")]


@pytest.mark.parametrize(("formula", "columns"), cases(__file__, "used"))
def test_a_fit_names_the_row_of_every_empty_cell_that_a_formula_uses(holed, formula, columns):
    with pytest.raises(bt.InputError) as refused:
        bt.fit(holed.folder, K=formula)
    cells = [problem for problem in refused.value.problems if problem.row is not None]
    assert {(p.row, p.column) for p in cells} == {place for place in PLACES if place[1] in columns}
    impacts = pd.read_csv(holed.path("impacts.csv"))["impact"]
    for problem in cells:
        assert (problem.file, problem.value) == ("impacts.csv", "an empty cell")
        assert problem.impact == impacts[problem.row - 2]
        assert "Fill the cell" in problem.remedy
    assert "is missing in" in str(refused.value)


def test_of_tables_in_python_the_rows_are_counted_as_there(lab):
    impacts, traces = tables()
    impacts.loc[2, "sex"] = None
    made = bt.dataset(impacts, traces, **SETTINGS["signal"], uncertainty=SETTINGS["uncertainty"])
    with pytest.raises(bt.InputError, match=r"impacts \(rows from 0\), row 2, column sex, impact"):
        bt.fit(made, K="sex")


@pytest.mark.parametrize(("column", "subjects", "levels", "asked"), cases(__file__, "groups"))
def test_whoever_stands_in_two_groups_is_asked_about(
    column: str, subjects: str, levels: str, asked: int
) -> None:
    people = subjects.split()
    table = pd.DataFrame({"impact": [f"i{n}" for n in range(len(people))], "subject": people})
    table = table.assign(mass_kg=1.0, velocity_m_s=1.0, **{column: levels.split()}).astype(str)
    found = impact_table(table, np.arange(2, len(people) + 2), needs_velocity=True)
    assert [p.code for p in found.warnings] == ["one-person-or-two"] * asked
    assert all("one person or two?" in str(problem) for problem in found.warnings)


def test_a_standard_column_is_one_whatever_its_case(lab: Lab) -> None:
    path = lab.path("impacts.csv")
    expected = bt.read_dataset(path.parent).impacts
    head, body = path.read_text().split("\n", 1)
    path.write_text(f"{head.upper().replace('SUBJECT', 'PATIENT')}\n{body}")
    found = bt.read_dataset(path.parent).impacts
    standard = [name for name in expected if name in COLUMNS]
    pd.testing.assert_frame_equal(found[standard], expected[standard])
    # Two that differ by case alone are two.
    assert standard_names(["trial", "Trial", "Side", "MASS_KG", "Trace"]) == [
        *("trial", "Trial", "Side", "mass_kg", "trace")
    ]


def test_a_formula_finds_columns_whatever_their_case_and_names_the_near_one() -> None:
    rows = pd.DataFrame({"subject": list("aabbccdd"), "trial": "x", "mass_kg": [1.0, 2.0] * 4})
    rows["Group"] = list("ttttcccc")
    assert str(resolve("group + (1|Patient)", rows, 1.0).terms) == "Group + (1|subject)"
    assert resolve("group + (1|Patient)", rows, 1.0).faults == ()
    for formula in ("GRUP", "(1|grup)", "(grup|subject)"):
        (fault,) = resolve(formula, rows, 1.0).faults
        assert fault.reason.endswith("; Group is near")
    # Two that differ by case alone are two.
    twice = rows.assign(group=list("tctctctc"))
    assert str(resolve("group", twice, 1.0).terms) == "group"
