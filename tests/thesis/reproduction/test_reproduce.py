from __future__ import annotations

import pandas as pd
import pytest

from bayestissue.base.results.tables import columns_of
from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction import reproduce_published


@pytest.fixture(scope="module")
def table(published: PublishedTables) -> pd.DataFrame:
    return reproduce_published(published)


def test_columns_and_counts(table: pd.DataFrame) -> None:
    assert list(table.columns) == columns_of("reproduction")
    assert (table["reproduced"] != "").sum() == 191
    assert table["agrees"].value_counts().to_dict() == {True: 110, False: 62}
    assert not table.duplicated(["table", "row", "quantity"]).any()


def test_agreement_is_given_where_both_numbers_are(table: pd.DataFrame) -> None:
    both = (table["published"] != "") & (table["reproduced"] != "")
    assert (table["agrees"].notna() == both).all()


def test_what_is_missing_or_differs_is_explained(table: pd.DataFrame) -> None:
    unexplained = table[(table["note"] == "") & ~table["agrees"].fillna(False)]
    assert unexplained.empty


def test_every_surviving_printed_statistic_is_there(table: pd.DataFrame, published: PublishedTables) -> None:
    printed = set(table["published"])
    for column in ("average_text", "sd_text", "range_text"):
        assert set(published.averages[column]) <= printed
    assert set(published.correlations["correlation_text"]) <= printed
    assert set(published.regressions["coefficient_text"]) <= printed
    assert (table["table"].str.startswith("section")).sum() == len(published.claims)


def test_it_survives_a_csv_file(table: pd.DataFrame, tmp_path: object) -> None:
    path = f"{tmp_path}/reproduction.csv"
    table.to_csv(path, index=False)
    kinds = {"table": str, "published": str, "reproduced": str, "agrees": "boolean", "note": str}
    again = pd.read_csv(path, dtype=kinds).fillna({"published": "", "reproduced": "", "note": ""})
    pd.testing.assert_frame_equal(again, table, check_dtype=False)
