from __future__ import annotations

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


def test_the_dictionary_describes_every_column() -> None:
    folder = shared("data", "published")
    dictionary = pd.read_csv(folder / "dictionary.csv")
    described = set(zip(dictionary["file"], dictionary["column"], strict=True))
    files = [path for path in folder.glob("*.csv") if path.name != "dictionary.csv"]
    assert {path.stem for path in files} >= set(TABLES)
    assert described >= {(path.name, column) for path in files for column in pd.read_csv(path, nrows=0)}


@pytest.mark.parametrize(("name", "key"), KEYS.items())
def test_no_row_stands_twice(published: PublishedTables, name: str, key: list[str]) -> None:
    assert not getattr(published, name).duplicated(key).any()
