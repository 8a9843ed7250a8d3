"""What file names say, and the columns that it becomes."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.formats.channel import unit_in_name
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.names import Pattern, columns
from cases import cases


@pytest.mark.parametrize(("pattern", "file", "found"), cases(__file__, "read"))
def test_fields_come_out_of_a_name(pattern: str, file: str, found: dict[str, str]) -> None:
    assert Pattern.parse(pattern).read(Source(Path(file), file)) == found


# Fields of a name, of which none has what stands between them.
WORDS = st.from_regex(r"[A-Za-z0-9]+([ .-][A-Za-z0-9]+)?", fullmatch=True)
FIELDS = st.dictionaries(st.from_regex(r"[a-z]{1,6}", fullmatch=True), WORDS, min_size=1)


@given(FIELDS)
def test_fields_go_there_and_back(fields: dict[str, str]) -> None:
    pattern = Pattern.parse("_".join(f"{{{field}}}" for field in fields))
    name = f"{'_'.join(fields.values())}.csv"
    assert pattern.read(Source(Path(name), name)) == fields


@pytest.mark.parametrize(("pattern", "file", "says"), cases(__file__, "two_ways"))
def test_a_name_that_can_be_read_in_two_ways_is_refused_with_both(pattern: str, file: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Pattern.parse(pattern).read(Source(Path(file), file))


@pytest.mark.parametrize("field", ["", "mass_kg", "größe"])
def test_many_fields_take_no_longer_than_few(field: str) -> None:
    names = [f"{{{field and field + (str(number) if number else '')}}}" for number in range(24)]
    pattern = Pattern.parse("{subject}_" + "".join(names) + "x")
    begin = time.monotonic()
    with pytest.raises(InputError, match="a name like"):
        pattern.read(Source.at(Path(f"s1_{'1' * 200}y.csv")))
    # Backtracking would not end within anybody's life.
    assert time.monotonic() - begin < 2


@pytest.mark.parametrize("name", ["(" + 20_000 * " " + "x", 20_000 * "(" + " ", "a(" + 20_000 * " " + ")x"])
def test_a_long_name_of_a_column_is_looked_through_once(name: str) -> None:
    begin = time.monotonic()
    assert not unit_in_name(name)
    assert time.monotonic() - begin < 2
    assert unit_in_name("Impact ( m/s^2 ) ") == "m/s^2"


@pytest.mark.parametrize(("pattern", "says"), cases(__file__, "refused"))
def test_a_pattern_that_is_none_is_refused(pattern: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        Pattern.parse(pattern)
    assert says in str(refused.value)
    assert "--pattern" in str(refused.value)


# Of which twelve digits are kept.
FELL = pytest.approx(math.sqrt(2 * 9.80665 * 0.45), rel=1e-11)


@pytest.mark.parametrize(
    ("fields", "cells"),
    [
        ({"mass_g": "250", "n": "07"}, {"mass_kg": 0.25, "n": "07"}),
        ({"drop_height_m": "0.45"}, {"velocity_m_s": FELL, "drop_height_m": 0.45}),
        ({"drop_height_cm": "45,0"}, {"velocity_m_s": FELL, "drop_height_cm": 45.0}),
        ({"velocity_m_s": "1.5", "side": "left"}, {"velocity_m_s": 1.5, "side": "left"}),
    ],
)
def test_fields_fill_columns_in_their_units(fields: dict[str, str], cells: dict[str, object]) -> None:
    assert columns(fields, "a.lvm") == cells


@pytest.mark.parametrize("text", ["0", "-1", "heavy", "1e999", ""])
def test_a_number_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"a\.lvm, column mass_g: found .*expected a number above 0"):
        columns({"mass_g": text}, "a.lvm")
