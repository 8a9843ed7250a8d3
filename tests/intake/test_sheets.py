"""Workbooks of several recordings, a sheet each, and tables of one row a person."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError
from command_line import Outcome, init
from dataset_bench import deceleration
from recorder_files import workbook, xlsx

SHEETS = ("before_left", "before_right", "after_left", "after_right")
PEOPLE = ("p2", "p10")
VELOCITY = 1.2
MASS = {"mass_kg": 1}


def recorded(which: int) -> tuple[np.ndarray, np.ndarray]:
    return deceleration(1 + 0.001 * which, VELOCITY)


def rows(which: int) -> list[list[object]]:
    return [["Time (s)", "Acc (m/s^2)"], *np.column_stack(recorded(which)).tolist()]


@pytest.fixture(scope="module")
def clinic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workbook a person with four sheets, one of notes, an empty one and a hidden one."""
    folder = tmp_path_factory.mktemp("clinic")
    (folder / "books").mkdir()
    for person, name in enumerate(PEOPLE):
        sheets = {sheet: rows(4 * person + n) for n, sheet in enumerate(SHEETS)}
        sheets = {"notes": [["examiner", "A. B."], ["age", 41]], "Sheet9": [], **sheets, "raw": rows(99)}
        workbook(folder / "books" / f"{name}.xlsx", sheets, hidden=("raw",))
    patients = [("P2", "treated", 1), ("p10", "control", 1), ("p11", "treated", 1)]
    xlsx(folder / "patients.xlsx", [["subject", "group", "mass_kg"], *map(list, patients)])
    return folder


def made_of(clinic: Path, out: Path, facts: dict[str, object] | None = None, **given: object) -> Outcome:
    return init(clinic / "books", out, set={"velocity_m_s": VELOCITY} | (facts or {}), **given)


@pytest.mark.slow
@pytest.mark.parametrize("pattern", [None, "{subject}.xlsx#{session}_{side}", "{subject}#{session}_{side}"])
def test_each_sheet_is_a_recording(pattern: str | None, clinic: Path, tmp_path: Path) -> None:
    made = made_of(clinic, tmp_path / "d", MASS, pattern=pattern)
    assert (made.status, made.err) == (0, "")
    assert "passed over: hidden sheets: p2.xlsx (raw), p10.xlsx (raw)" in made.out
    assert "sheets without a recording: p2.xlsx (notes), p10.xlsx (notes)" in made.out
    data = bt.read_dataset(tmp_path / "d")
    table = data.impacts
    assert table["impact"].iloc[0] == "p2_before_left"
    assert table["trace"].tolist() == [f"recordings/{who}.xlsx#{sheet}" for who in PEOPLE for sheet in SHEETS]
    assert (table["session"] + "_" + table["side"]).tolist() == list(SHEETS) * 2
    for which, trace in enumerate(data.traces):
        np.testing.assert_array_equal(trace.value, recorded(which)[1])
    assert {path.name for path in (tmp_path / "d" / "recordings").iterdir()} == {"p2.xlsx", "p10.xlsx"}


def test_a_table_of_one_row_a_person_is_joined(clinic: Path, tmp_path: Path) -> None:
    made = made_of(clinic, tmp_path / "d", table=clinic / "patients.xlsx")
    assert (made.status, made.err) == (0, "")
    assert "passed over: rows of patients.xlsx without a recording: p11" in made.out
    table = bt.read_dataset(tmp_path / "d").impacts
    assert table["subject"].tolist() == [who for who in PEOPLE for _ in SHEETS]
    assert table["group"].tolist() == ["treated"] * 4 + ["control"] * 4
    (tmp_path / "few.csv").write_text("subject,side,mass_kg\np10,left,1\np10,right,1\np2,left,1\np2,left,2\n")
    refused = made_of(clinic, tmp_path / "e", table=tmp_path / "few.csv")
    assert refused.status == 2
    assert "expected a row for subject p2, side right (p2.xlsx#before_right)" in refused.err
    assert "expected one row for subject p2, side left" in refused.err
    (tmp_path / "few.csv").write_text("athlete_name,mass_kg\np2,1\n")
    refused = made_of(clinic, tmp_path / "e", table=tmp_path / "few.csv")
    assert "expected a column file, or one that the names of the recordings have too" in refused.err
    assert not (tmp_path / "e").exists()


def test_a_pattern_without_sheets_reads_the_first_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "books").mkdir()
    for n, who in enumerate(("p1", "p2")):
        sheets = {sheet: rows(2 * n + m) for m, sheet in enumerate(SHEETS[:2])}
        workbook(tmp_path / "books" / f"{who}.xlsx", sheets)
    made = made_of(tmp_path, tmp_path / "d", MASS, pattern="{subject}.xlsx")
    assert made.status == 0, made.err
    assert 'behind the first (--pattern "{subject}.xlsx#{}" reads each): p1.xlsx (before_right)' in made.out
    traces = bt.read_dataset(tmp_path / "d").impacts["trace"].tolist()
    assert traces == ["recordings/p1.xlsx", "recordings/p2.xlsx"]


def test_a_workbook_of_one_recording_has_its_own_name(tmp_path: Path) -> None:
    (tmp_path / "books").mkdir()
    for n, who in enumerate(("p1_left", "p1_right")):
        workbook(tmp_path / "books" / f"{who}.xlsx", {"Sheet1": rows(n), "Sheet2": [], "Sheet3": []})
    made = made_of(tmp_path, tmp_path / "d", MASS)
    assert made.status == 0, made.err
    assert bt.read_dataset(tmp_path / "d").impacts["impact"].tolist() == ["p1_left", "p1_right"]
    impacts = tmp_path / "d" / "impacts.csv"
    impacts.write_text(impacts.read_text().replace("p1_left.xlsx", "p1_left.xlsx#before"))
    with pytest.raises(InputError, match=r'found "before"; expected a sheet of the workbook. It has: Sheet1'):
        bt.read_dataset(tmp_path / "d")
    workbook(tmp_path / "books" / "p1_left.xlsx", {"Sheet1": [], "Sheet2": []})
    refused = made_of(tmp_path, tmp_path / "e", MASS)
    assert 'p1_left.xlsx#Sheet1: found "empty sheets"' in refused.err
