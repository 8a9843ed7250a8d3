"""How text tables are written is found: in every country's spelling, and never against what stands there."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.cells import read_cells
from bayestissue.recordings.dataset.dialect import DECIMALS, DELIMITERS, Dialect, Stated, text_table
from bayestissue.recordings.dataset.formats.channel import Contents
from bayestissue.recordings.dataset.sample_tables import read_table
from bayestissue.recordings.dataset.source_files import Source

TIME = np.arange(300) / 1000 - 0.005
VALUE = 1500 * np.sin(40 * TIME) + 0.25


def grouped(text: str, decimal: str, thousands: str) -> str:
    return text.replace(",", "t").replace(".", decimal).replace("t", thousands)


def table(
    delimiter: str,
    decimal: str,
    *,
    thousands: str = "",
    above: str = "",
    names: str = "Zeit|Kraft",
    below: str = "",
) -> str:
    form = "{:,.4f}" if thousands else "{:.4f}"
    cells = [
        [grouped(form.format(number), decimal, thousands) for number in pair]
        for pair in zip(TIME, VALUE, strict=True)
    ]
    quoted = [[f'"{cell}"' if delimiter in cell else cell for cell in pair] for pair in cells]
    lines = [names.replace("|", delimiter)] if names else []
    lines += [below.replace("|", delimiter)] if below else []
    return (
        above.replace("|", delimiter) + "\n".join([*lines, *(delimiter.join(pair) for pair in quoted)]) + "\n"
    )


def read(path: Path, text: str, encoding: str = "utf-8", stated: Stated | None = None):
    path.write_bytes(text.encode(encoding))
    return read_table(Source.at(path, stated=stated), numbers=None)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
@pytest.mark.parametrize("decimal", DECIMALS.values())
@pytest.mark.parametrize("delimiter", DELIMITERS.values())
def test_numbers_are_those_that_were_written(
    delimiter: str, decimal: str, encoding: str, tmp_path: Path
) -> None:
    names = "Zeit|Beschleunigung_ä"
    found = read(tmp_path / "a.csv", table(delimiter, decimal, names=names), encoding)
    assert list(found.channels) == names.split("|")
    for column, written in zip(found.channels.values(), (TIME, VALUE), strict=True):
        np.testing.assert_array_equal(column.values, written.round(4))
        assert not column.text
    assert found.dialect is not None
    assert found.dialect.delimiter == delimiter
    assert found.dialect.decimal == decimal
    assert found.first_row == 2


@pytest.mark.parametrize("thousands", [".", ",", " ", "\u00a0", "\u202f", "'", "\u2019"])
@pytest.mark.parametrize("decimal", DECIMALS.values())
@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_thousands(delimiter: str, decimal: str, thousands: str, tmp_path: Path) -> None:
    if thousands == decimal:
        return
    found = read(tmp_path / "a.csv", table(delimiter, decimal, thousands=thousands))
    np.testing.assert_array_equal(found.channels["Kraft"].values, VALUE.round(4))


@pytest.mark.parametrize(
    ("above", "below", "units", "rows"),
    [
        ("", "", ["", ""], (1, 0, 2)),
        ("", "s|m/s²", ["s", "m/s²"], (1, 2, 3)),
        ("", "[s]|[V]", ["s", "V"], (1, 2, 3)),
        ("", "(ms)|(g)", ["ms", "g"], (1, 2, 3)),
        ("Recorder 7\nDate|24.11.2026\nRate|10000\n\n", "s|-", ["s", "-"], (5, 6, 7)),
        ("Recorder 7\n\n\nnotes: none, really\n", "", ["", ""], (5, 0, 6)),
        ("sep=|\n", "", ["", ""], (2, 0, 3)),
    ],
)
@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_lines_above_the_numbers(
    delimiter: str, above: str, below: str, units: list[str], rows: tuple[int, int, int], tmp_path: Path
) -> None:
    found = read(tmp_path / "a.csv", table(delimiter, ".", above=above, below=below))
    assert list(found.channels) == ["Zeit", "Kraft"]
    assert [column.unit for column in found.channels.values()] == units
    np.testing.assert_array_equal(found.channels["Kraft"].values, VALUE.round(4))
    assert found.dialect is not None
    assert (found.dialect.header_row, found.dialect.units_row, found.dialect.first_row) == rows


@pytest.mark.parametrize("delimiter", [",", ";", " "])
def test_columns_without_names_are_numbered(delimiter: str, tmp_path: Path) -> None:
    found = read(tmp_path / "a.csv", table(delimiter, ".", names=""))
    assert list(found.channels) == ["column 1", "column 2"]
    assert found.channels["column 1"].values.size == TIME.size
    counted = read(tmp_path / "a.csv", table(delimiter, ".", names="0|1"))
    assert list(counted.channels) == ["0", "1"]
    assert counted.channels["0"].values.size == TIME.size


def test_a_mark_at_the_end_of_each_line_makes_no_column(tmp_path: Path) -> None:
    text = table(";", ",").replace("\n", ";\n")
    for whole in (text, text.replace("Kraft;", "Kraft")):
        found = read(tmp_path / "a.csv", whole)
        np.testing.assert_array_equal(found.channels["Kraft"].values, VALUE.round(4))


def test_columns_by_spaces(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    np.savetxt(path, np.column_stack([TIME, VALUE]), header="t  a", fmt="%12.4f")
    found = read_table(Source.at(path), numbers=None)
    assert list(found.channels) == ["t", "a"]
    np.testing.assert_array_equal(found.channels["a"].values, VALUE.round(4))


def test_one_mark_in_a_number_is_never_taken_for_thousands(tmp_path: Path) -> None:
    """1.234 kg among decimal commas may be 1234 or a slip: it is no number until somebody says so."""
    text = "a;b\n0,5;1.234\n1,5;2,5\n2,5;3,5\n"
    found = read(tmp_path / "a.csv", text)
    assert found.channels["b"].text == {0: "1.234"}
    said = read(tmp_path / "a.csv", text, stated=Stated(thousands="point"))
    np.testing.assert_array_equal(said.channels["b"].values, [1234, 2.5, 3.5])


def test_what_is_stated_is_not_looked_for(tmp_path: Path) -> None:
    text = "a\n0,5\n1,5\n"
    with pytest.raises(InputError, match="2 cells: 0,5"):
        read(tmp_path / "a.csv", text)
    np.testing.assert_array_equal(
        read(tmp_path / "a.csv", text, stated=Stated(delimiter="semicolon")).channels["a"].values, [0.5, 1.5]
    )
    two = read(tmp_path / "b.csv", "u;v\na;b\n1;2\n3;4\n", stated=Stated(header_row=1, units_row=2))
    assert [(name, column.unit) for name, column in two.channels.items()] == [("u", "a"), ("v", "b")]


def test_a_row_that_is_stated_must_be_there(tmp_path: Path) -> None:
    for key, row in (("header_row", 9), ("units_row", 2)):
        with pytest.raises(InputError, match=f"column {key}: found {row}; expected a row that is not empty"):
            read(tmp_path / "a.csv", "a;b\n\n1;2\n3;4\n", stated=Stated(**{key: row}))
    without = read(tmp_path / "a.csv", "s;g\n1;2\n3;4\n", stated=Stated(header_row=0))
    assert list(without.channels) == ["column 1", "column 2"]


def test_empty_columns_of_a_spreadsheet_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("file;mass_kg;;\na;0,5;;\nb;1,5;;\n;;;\n")
    cells, rows = read_cells(Source.at(path), ["file"])
    assert cells.to_dict("list") == {"file": ["a", "b"], "mass_kg": ["0.5", "1.5"]}
    assert rows.tolist() == [2, 3]
    path.write_text("file;mass_kg;;\na;0,5;;x\n")
    with pytest.raises(InputError, match="a name over every column"):
        read_cells(Source.at(path), ["file"])


def test_a_wanted_name_finds_its_line() -> None:
    found = text_table(b"x,y\ntime_s,value\n1,2\n", Source(Path("a"), "a"), wanted=["value"])
    assert (found.names, found.dialect.header_row) == (["time_s", "value"], 2)


def test_bad_cells_at_the_top_are_no_header(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,value\nn/a,-9\n" + "".join(f"{t},{t}\n" for t in range(50)))
    found = read_table(Source.at(path), numbers=["time_s", "value"])
    assert found.channels["time_s"].text == {0: "n/a"}
    assert found.first_row == 2


def test_rows_that_break_are_one_problem_with_the_first_place(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Gerät;1\n\nt;v\n1;2\n3;4;5\n6;7\n8;9;1\n" + "1;2\n" * 20)
    with pytest.raises(InputError) as refused:
        read_table(Source.at(path), numbers=None)
    (problem,) = refused.value.problems
    assert problem.row == 5
    assert "1 more row is like this" in problem.remedy


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"a;b\n\xc3\xa4;\xff\n1;2\n", "row 2.*UTF-8, UTF-16 or cp1252"),
        (b"a;b\n1;\x81\n", "row 2.*UTF-8, UTF-16 or cp1252"),
        (b"a;b\n1;2\n3;\x00\n", "row 3.*a byte that is 0"),
    ],
)
def test_damaged_text_is_refused(data: bytes, says: str) -> None:
    with pytest.raises(InputError, match=says):
        text_table(data, Source(Path("a.csv"), "a.csv"))


def test_the_words_name_all_that_was_found() -> None:
    words = str(Dialect("utf-16", "\t", ",", ".", 3, 4, 5))
    assert words == (
        "UTF-16, a tab between cells, a decimal comma, a point between thousands, "
        "names in row 3, units in row 4"
    )


@pytest.mark.slow
@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    text=st.text(alphabet="0123456789.,;\t| '\"eE+-ams\n\r\u00a0", max_size=200),
    encoding=st.sampled_from(["utf-8", "utf-16", "cp1252"]),
)
def test_any_text_is_read_or_refused(text: str, encoding: str) -> None:
    """Never a traceback; as numbers only what are numbers in the spelling that was found."""
    path = Path(tempfile.mkdtemp()) / "a.csv"
    try:
        for read_any in (lambda: read(path, text, encoding), lambda: read_cells(Source.at(path), ())):
            try:
                found = read_any()
            except InputError:
                continue
            if isinstance(found, Contents):
                assert all(np.isfinite(each.values).any() for each in found.channels.values())
    finally:
        shutil.rmtree(path.parent)
