from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.resources import shared
from bayestissue.recordings.dataset.published import PublishedTables, read_published

# The columns that tell the rows of a table apart.
KEYS = {
    "estimates": ["trial", "subject"],
    "averages": ["quantity", "trial"],
    "correlations": ["table", "row"],
    "stepwise": ["table", "quantity", "status", "row"],
    "regressions": ["quantity", "term"],
    "claims": ["claim"],
}
TABLES = tuple(KEYS)


@pytest.fixture(scope="module")
def published() -> PublishedTables:
    return read_published()


def test_every_surviving_row_is_there(published: PublishedTables) -> None:
    assert [len(getattr(published, name)) for name in TABLES] == [70, 18, 39, 25, 5, 63]
    assert set(published.estimates["trial"]) == {8, 9, 16, 17, 18, 26, 27}
    assert set(published.estimates.groupby("trial")["subject"].apply(tuple)) == {tuple(range(1, 11))}
    assert list(published.averages["trial"]) == [7, 8, 9, 16, 17, 18, 25, 26, 27] * 2


def test_numbers_keep_the_digits_that_were_printed(published: PublishedTables) -> None:
    k = published.averages.query("quantity == 'K'").set_index("trial")
    assert k.loc[16, "average_text"] == "23.75"
    assert k.loc[27, "range_text"] == "2.360"
    assert k.loc[16, "mass_kg_text"] == "1.000"
    terms = published.regressions.set_index(["quantity", "term"])
    assert terms.loc[("K", "constant"), "coefficient_text"] == "+0.695"


def test_slips_are_kept(published: PublishedTables) -> None:
    k = published.averages.query("quantity == 'K'").set_index("trial")
    assert k.loc[17, "sd"] == k.loc[17, "range"] == 1.977
    assert ".0122" in set(published.claims["value_text"])
    with_mass = published.claims.query("section == '6.2' and statistic == 'correlation with Mass'")
    assert list(with_mass["value"]) == [0.787, 0.992, 0.787]


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
    assert all(path.parent == shared("data", "published") for path in published.paths)


@pytest.mark.parametrize(("name", "key"), KEYS.items())
def test_no_row_stands_twice(published: PublishedTables, name: str, key: list[str]) -> None:
    assert not getattr(published, name).duplicated(key).any()


def test_a_condition_belongs_to_its_trial(published: PublishedTables) -> None:
    columns = ["trial", "energy_J", "velocity_m_s", "mass_kg"]
    both = pd.concat([published.averages[columns], published.estimates[columns]])
    assert len(both.drop_duplicates()) == both["trial"].nunique() == 9
