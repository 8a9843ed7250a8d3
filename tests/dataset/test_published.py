from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayestissue.dataset.published import PublishedTables, read_published
from bayestissue.errors import InputError
from bayestissue.resources import shared

TABLES = ("estimates", "averages", "correlations", "stepwise", "regressions", "claims")


@pytest.fixture(scope="module")
def published() -> PublishedTables:
    return read_published()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the published tables to spoil."""
    shutil.copytree(shared("data", "published"), tmp_path / "published")
    return tmp_path / "published"


def spoil(folder: Path, file: str, row: int, column: str, text: str) -> None:
    table = pd.read_csv(folder / file, dtype=str, keep_default_na=False)
    table.loc[row - 2, column] = text
    table.to_csv(folder / file, index=False)


def test_every_surviving_row_is_there(published: PublishedTables) -> None:
    assert {name: len(getattr(published, name)) for name in TABLES} == {
        "estimates": 70,
        "averages": 18,
        "correlations": 39,
        "stepwise": 25,
        "regressions": 5,
        "claims": 63,
    }
    assert set(published.estimates["trial"]) == {8, 9, 16, 17, 18, 26, 27}
    assert (
        published.estimates.groupby("trial")["subject"].apply(list).map(lambda s: s == [*range(1, 11)]).all()
    )
    assert list(published.averages["trial"]) == [7, 8, 9, 16, 17, 18, 25, 26, 27] * 2


def test_numbers_keep_the_digits_that_were_printed(published: PublishedTables) -> None:
    k = published.averages.query("quantity == 'K'").set_index("trial")
    assert k.loc[16, "average_text"] == "23.75"
    assert k.loc[27, "range_text"] == "2.360"
    assert k.loc[16, "mass_kg_text"] == "1.000"
    assert published.regressions.set_index(["quantity", "term"]).loc[
        ("K", "constant"), "coefficient_text"
    ] == ("+0.695")


def test_slips_are_kept(published: PublishedTables) -> None:
    k = published.averages.query("quantity == 'K'").set_index("trial")
    assert k.loc[17, "sd"] == k.loc[17, "range"] == 1.977
    assert ".0122" in set(published.claims["value_text"])
    assert list(
        published.claims.query("section == '6.2' and statistic == 'correlation with Mass'")["value"]
    ) == [
        0.787,
        0.992,
        0.787,
    ]


@pytest.mark.parametrize("name", TABLES)
def test_types(published: PublishedTables, name: str) -> None:
    table = getattr(published, name)
    counts = [column for column in ("trial", "subject", "row", "claim") if column in table]
    assert all(table[column].dtype == np.int64 for column in counts)
    printed = [column.removesuffix("_text") for column in table if column.endswith("_text")]
    for column in printed:
        assert table[column].dtype == np.float64
        given = table[f"{column}_text"] != ""
        assert (table.loc[given, f"{column}_text"].astype(float) == table.loc[given, column]).all()
        assert table.loc[~given, column].isna().all()


def test_only_p_values_may_be_empty(published: PublishedTables) -> None:
    assert published.correlations["p_value"].isna().sum() == 26
    assert not published.correlations["correlation"].isna().any()


def test_the_dictionary_describes_every_column() -> None:
    folder = shared("data", "published")
    dictionary = pd.read_csv(folder / "dictionary.csv")
    described = set(zip(dictionary["file"], dictionary["column"], strict=True))
    files = [path for path in folder.glob("*.csv") if path.name != "dictionary.csv"]
    assert {path.stem for path in files} >= set(TABLES)
    assert described >= {(path.name, column) for path in files for column in pd.read_csv(path, nrows=0)}


def test_the_paths_are_the_files_read(published: PublishedTables) -> None:
    assert [path.stem for path in published.paths] == list(TABLES)
    assert all(path.parent == published.folder for path in published.paths)


def test_everything_wrong_is_listed_at_once(folder: Path) -> None:
    spoil(folder, "estimates.csv", 4, "K", "eleven")
    spoil(folder, "estimates.csv", 5, "C", "-1")
    spoil(folder, "averages.csv", 2, "sd", "")
    spoil(folder, "correlations.csv", 3, "quantity", "B")
    spoil(folder, "estimates.csv", 6, "trial", "8.5")
    (folder / "claims.csv").unlink()
    with pytest.raises(InputError) as caught:
        read_published(folder)
    found = {(Path(p.file).name, p.row, p.column, p.value) for p in caught.value.problems}
    assert found == {
        ("estimates.csv", 4, "K", "eleven"),
        ("estimates.csv", 5, "C", "-1"),
        ("estimates.csv", 6, "trial", "8.5"),
        ("averages.csv", 2, "sd", ""),
        ("correlations.csv", 3, "quantity", "B"),
        ("claims.csv", None, None, "FileNotFoundError"),
    }


def test_a_missing_column_is_named(folder: Path) -> None:
    table = pd.read_csv(folder / "estimates.csv", dtype=str).drop(columns="mass_kg")
    table.to_csv(folder / "estimates.csv", index=False)
    with pytest.raises(InputError) as caught:
        read_published(folder)
    (problem,) = caught.value.problems
    assert (problem.row, problem.column) == (1, "mass_kg")


def test_an_empty_table_is_refused(folder: Path) -> None:
    (folder / "stepwise.csv").write_text("table,row,quantity,status,variable\n")
    with pytest.raises(InputError, match="at least one row"):
        read_published(folder)


def test_rows_longer_than_the_header_are_refused(folder: Path) -> None:
    path = folder / "regressions.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(f"x,{row}" for row in rows)]))
    with pytest.raises(InputError, match="as many cells"):
        read_published(folder)


def test_rows_shorter_than_the_header_are_refused(folder: Path) -> None:
    path = folder / "stepwise.csv"
    path.write_text(path.read_text() + "5.17,12,C,entered\n")
    with pytest.raises(InputError) as caught:
        read_published(folder)
    (problem,) = caught.value.problems
    assert (problem.row, problem.column, problem.value) == (27, "variable", "")


def test_a_row_that_stands_twice_is_refused(folder: Path) -> None:
    spoil(folder, "estimates.csv", 3, "subject", "1")
    with pytest.raises(InputError, match="each trial, subject once") as caught:
        read_published(folder)
    assert caught.value.problems[0].row == 3


@pytest.mark.parametrize(("column", "text"), [("mass_kg", "0.5"), ("trial", "99")])
def test_a_condition_belongs_to_its_trial(folder: Path, column: str, text: str) -> None:
    spoil(folder, "estimates.csv", 7, column, text)
    with pytest.raises(InputError) as caught:
        read_published(folder)
    assert {(Path(p.file).name, p.row) for p in caught.value.problems} == {("estimates.csv", 7)}


def test_other_tables_of_the_same_layout_can_be_read(folder: Path) -> None:
    spoil(folder, "estimates.csv", 2, "K", "12.000")
    assert read_published(folder).estimates.loc[0, "K"] == 12.0
