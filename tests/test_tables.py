"""The declaration of result tables: what is written is read as it was, and what is wrong is named."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.base.errors import InputError
from bayestissue.base.results.tables import (
    declared_files,
    read_table,
    read_tables,
    table_of_rows,
    typed,
    write_table,
)
from bayestissue.reports.pages.page_tables import declared_fields


@pytest.fixture
def contrasts() -> pd.DataFrame:
    rows = [("side", "left", "right", "K", 1.1, 0.9, 1.3, 0.8, 0.4), ("1", "2", "3", "C", 1, np.nan, 3, 0, 0)]
    return table_of_rows("contrasts", [(*row, "levels", "", 0.8, 1.5) for row in rows])


def test_a_table_is_read_as_it_was(contrasts, tmp_path):
    write_table(contrasts, tmp_path / "contrasts.csv")
    read = read_table(tmp_path, "contrasts")
    # Levels are names, also where they are numbers.
    assert read["level"].tolist() == ["left", "2"]
    pd.testing.assert_frame_equal(read, typed("contrasts", contrasts), check_dtype=False)
    assert read["ratio"].dtype.kind == "f"


def test_all_that_is_wrong_is_named_at_once(contrasts, tmp_path):
    write_table(contrasts.drop(columns="against").assign(low="wide"), tmp_path / "contrasts.csv")
    with pytest.raises(InputError) as caught:
        read_tables(tmp_path, ["contrasts", "levels"], may_lack=["questions"])
    named = {
        (problem.file.rsplit("/", 1)[-1], problem.row, problem.column) for problem in caught.value.problems
    }
    assert named == {
        ("contrasts.csv", 1, "against"),
        ("contrasts.csv", 2, "low"),
        ("contrasts.csv", 3, "low"),
        ("levels.csv", None, None),
    }


def test_what_is_shown_is_made_of_columns_of_the_file():
    views = [(name, file, *view) for name, file in declared_files().items() for view in file.looks.items()]
    for name, file, view, looks in (one for one in views if one[3]):
        assert {column for look in looks.values() for column in look["of"]} <= set(file.columns), name
        fields = declared_fields(name.removesuffix(".csv"), looks, view, near="10 %")
        optional = [look.get("optional", False) for look in looks.values()]
        assert [field.optional for field in fields] == optional
    assert declared_files()["levels.csv"].columns["level"].kind == "text"


COMPUTED = ["=1+1", "-x", "@SUM(A1)", "+", "'=x", "-1.5 mm"]
PLAIN = ["-1.5", "+2", "-1,5", "a=b", "'x", "it's", "−1"]


@pytest.mark.parametrize("kind", ["object", "str", "category"])
def test_no_spreadsheet_computes_a_name_and_it_is_read_as_it_was(kind: str, tmp_path) -> None:
    names = COMPUTED + PLAIN
    table = table_of_rows("contrasts").reindex(range(len(names)))
    table["factor"], table["level"], table["other"] = pd.Series(names, dtype=kind), "-9", "=9"
    table["ratio"], table["=column"] = -1.5, 1.0
    write_table(table, tmp_path / "contrasts.csv")
    plain = pd.read_csv(tmp_path / "contrasts.csv", dtype=str, keep_default_na=False)
    assert plain["factor"].tolist() == [f"'{name}" for name in COMPUTED] + PLAIN
    assert (set(plain["level"]), set(plain["other"])) == ({"-9"}, {"'=9"})
    assert set(plain["ratio"]) == {"-1.5"}
    assert plain.columns[-1] == "'=column"
    read = read_table(tmp_path, "contrasts")
    assert read["factor"].tolist() == names
    assert read["other"].tolist() == ["=9"] * len(names)
    assert read["=column"].tolist() == [1.0] * len(names)
