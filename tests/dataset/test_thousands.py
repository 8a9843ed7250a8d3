"""A mark before exactly three digits stands before decimals or between thousands: never silently read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.cells import read_cells
from bayestissue.recordings.dataset.dialect import Stated
from bayestissue.recordings.dataset.impact_table import impact_table
from bayestissue.recordings.dataset.sample_tables import read_table
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.names import columns
from cases import cases

# Further than a table is looked at to find its marks.
FAR = (";", "comma", [*["500"] * 300, "1,000"])
LETTERED = {",": '"{}"', ";": "{}", "\t": "{}"}


def table(delimiter: str, *cells: str) -> str:
    rows = [f"s{row}{delimiter}{LETTERED[delimiter].format(cell)}\n" for row, cell in enumerate(cells, 1)]
    return "".join([f"subject{delimiter}mass_g\n", *rows])


def masses(path: Path, text: str, stated: Stated | None = None) -> list[str]:
    path.write_text(text)
    return read_cells(Source.at(path, stated=stated))[0]["mass_g"].tolist()


@pytest.mark.parametrize(("delimiter", "mark", "cells"), [*cases(__file__, "refused"), FAR])
def test_what_can_be_read_in_two_ways_is_refused(
    delimiter: str, mark: str, cells: list[str], tmp_path: Path
) -> None:
    text, path = table(delimiter, *cells), tmp_path / "info.csv"
    where = next(row for row, cell in enumerate(cells, 2) if not cell.isdigit())
    with pytest.raises(InputError, match=rf", row {where}, column mass_g") as refused:
        masses(path, text)
    (problem,) = refused.value.problems
    assert (problem.row, problem.column, problem.code) == (where, "mass_g", "open-mark")
    assert "--text thousands=" in problem.remedy
    other = "point" if mark == "comma" else "comma"
    whole = [cell.replace(",", "").replace(".", "") for cell in cells]
    decimals = [cell.replace(",", ".") for cell in cells]
    for stated, expected in (
        (Stated(thousands=mark), whole),
        (Stated(decimal=other), whole),
        (Stated(decimal=mark), decimals),
        (Stated(thousands="none"), decimals),
        (Stated(thousands=other), decimals),
    ):
        assert masses(path, text, stated) == expected


@pytest.mark.parametrize(("delimiter", "cells", "read"), cases(__file__, "settled"))
def test_one_number_that_tells_settles_the_marks(
    delimiter: str, cells: list[str], read: list[str], tmp_path: Path
) -> None:
    assert masses(tmp_path / "a.csv", table(delimiter, *cells)) == read


def test_a_name_settles_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("trial;mass_g\n0,5;1,000\n0,5;1,500\n")
    with pytest.raises(InputError, match="mass_g"):
        read_cells(Source.at(tmp_path / "a.csv"), [])


def test_recordings_too(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("n;a\n" + "".join(f"{n};{n % 9 + 1},250\n" for n in range(300)))
    with pytest.raises(InputError, match=r"1,250.*one way"):
        read_table(Source.at(path), numbers=None)
    read = read_table(Source.at(path, stated=Stated(decimal="comma")), numbers=None).channels["a"]
    np.testing.assert_array_equal(np.unique(read.values)[:2], [1.25, 2.25])
    path.write_text(path.read_text() + "300;0,250\n")
    read = read_table(Source.at(path), numbers=None).channels["a"]
    assert np.unique(read.values)[1] == 1.25


def test_a_fact_of_an_option_or_a_name() -> None:
    with pytest.raises(InputError, match=r"1000, or 1\.000"):
        columns({"mass_g": "1,000"}, "--set")
    assert columns({"mass_g": "1,25"}, "a.csv") == {"mass_kg": 0.00125}


@pytest.mark.parametrize("column", ["mass_kg", "velocity_m_s", "drop_height_m"])
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_thousandth_of_the_others_is_never_fine(column: str, factor: float) -> None:
    table = pd.DataFrame(
        {"impact": ["a", "b", "c"], "subject": "s", "trial": "t", "mass_kg": [0.5, 0.8, 0.9]}
        | {"velocity_m_s": [1.0, 1.1, 1.2], "drop_height_m": [0.05, 0.06, 0.07]}
    )
    table.loc[1, column] *= factor
    said = impact_table(table.astype(str), np.arange(2, 5), needs_velocity=True)
    # What lies outside the usual limits too is named by these alone.
    assert [(w.row, w.column) for w in (*said.problems, *said.warnings)] == [(3, column)]
