"""What file names say, and the columns that it becomes."""

from __future__ import annotations

import math
import time
from pathlib import Path

import pytest

from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset.formats.channel import unit_in_name
from bayestissue.recordings.dataset.source_files import Source
from bayestissue.recordings.intake.names import Pattern, columns


@pytest.mark.parametrize(
    ("pattern", "file", "found"),
    [
        (
            "{subject}_{side}_{mass_kg}kg_{n}.lvm",
            "s01_left_2.5kg_3.lvm",
            {"subject": "s01", "side": "left", "mass_kg": "2.5", "n": "3"},
        ),
        ("{subject}-{mass_g}g", "A B-250g.tdms", {"subject": "A B", "mass_g": "250"}),
        ("{subject} {mass_kg}kg", "anna 2,5kg.lvm", {"subject": "anna", "mass_kg": "2,5"}),
        (
            "{subject}/{}_{drop_height_cm}cm",
            "day 1/s02/x_12cm.c3d",
            {"subject": "s02", "drop_height_cm": "12"},
        ),
        ("{subject}.{{{n}}}.csv.gz", "s1.{4}.csv.gz", {"subject": "s1", "n": "4"}),
        ("{subject} (x+y)_{n}", "s1 (x+y)_2.LVM", {"subject": "s1", "n": "2"}),
    ],
)
def test_fields_come_out_of_a_name(pattern: str, file: str, found: dict[str, str]) -> None:
    assert Pattern.parse(pattern).read(Source(Path(file), file)) == found


@pytest.mark.parametrize(
    ("pattern", "file", "says"),
    [
        ("{subject}_{side}", "a_b_left.lvm", "subject a, side b_left or subject a_b, side left"),
        ("{subject}{mass_kg}kg", "anna12kg.lvm", "subject anna, mass_kg 12 or subject anna1, mass_kg 2"),
        ("{mass_g}{n}", "123.lvm", "mass_g 1, n 23 or mass_g 12, n 3"),
    ],
)
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


def test_a_name_that_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match=r'x/s1.lvm: found "s1"; expected a name like "{subject}_{n}"'):
        Pattern.parse("{subject}_{n}").read(Source(Path("x/s1.lvm"), "x/s1.lvm"))


@pytest.mark.parametrize(
    ("pattern", "says"),
    [
        ("{subject", "expected '}'"),
        ("{mass_kg:g}kg", "a format after a name"),
        ("{subject!r}", "a format after a name"),
        ("{mass kg}", "{mass kg}"),
        ("{subject.__class__}", "{subject.__class__}"),
        ("{n}_{n}", "{n} twice"),
        ("{}_{}", "no name in braces"),
    ],
)
def test_a_pattern_that_is_none_is_refused(pattern: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        Pattern.parse(pattern)
    assert says in str(refused.value)
    assert "--pattern" in str(refused.value)


@pytest.mark.parametrize(
    ("fields", "cells"),
    [
        ({"mass_g": "250", "n": "07"}, {"mass_kg": 0.25, "n": "07"}),
        # v = sqrt(2 g h): 0.45 m fall for 0.303 s.
        ({"drop_height_m": "0.45"}, {"velocity_m_s": math.sqrt(2 * 9.80665 * 0.45), "drop_height_m": 0.45}),
        ({"drop_height_cm": "45,0"}, {"velocity_m_s": math.sqrt(2 * 9.80665 * 0.45), "drop_height_cm": 45.0}),
        ({"velocity_m_s": "1.5", "side": "left"}, {"velocity_m_s": 1.5, "side": "left"}),
    ],
)
def test_fields_fill_columns_in_their_units(fields: dict[str, str], cells: dict[str, object]) -> None:
    found = columns(fields, "a.lvm")
    assert found.keys() == cells.keys()
    # Twelve digits are kept.
    assert all(
        value == pytest.approx(cells[name], rel=1e-11) if isinstance(value, float) else value == cells[name]
        for name, value in found.items()
    )


@pytest.mark.parametrize("text", ["0", "-1", "heavy", "1e999", ""])
def test_a_number_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"a\.lvm, column mass_g: found .*expected a number above 0"):
        columns({"mass_g": text}, "a.lvm")
