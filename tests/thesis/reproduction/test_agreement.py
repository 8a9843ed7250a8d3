from __future__ import annotations

from decimal import ROUND_DOWN, ROUND_HALF_DOWN, ROUND_HALF_UP, Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayestissue.thesis.reproduction.agreement import Recomputed, agrees, is_cut_off, line

numbers = st.decimals(min_value=-100, max_value=100, places=6)
digits = st.integers(min_value=0, max_value=5)


@given(value=numbers, places=digits)
def test_agreement_is_equality_after_rounding(value: Decimal, places: int) -> None:
    step = Decimal(1).scaleb(-places)
    either_way = {value.quantize(step, ROUND_HALF_UP), value.quantize(step, ROUND_HALF_DOWN)}
    for printed in {*either_way, value.quantize(step) + step, value.quantize(step) - step}:
        assert agrees(f"{printed:f}", float(value)) == (printed in either_way)


@given(value=numbers, places=digits)
def test_cutting_off_drops_digits(value: Decimal, places: int) -> None:
    step = Decimal(1).scaleb(-places)
    cut = value.quantize(step, ROUND_DOWN)
    assert is_cut_off(f"{cut:f}", float(value))
    assert not is_cut_off(f"{cut + step:f}", float(value))


@pytest.mark.parametrize(
    ("printed", "found", "agreed", "note"),
    [
        ("2.293", Recomputed(2.2935), True, ""),
        ("2.294", Recomputed(2.2935), True, ""),
        ("2.294", Recomputed(2.2931), False, "one unit off"),
        ("0.752", Recomputed(0.75279), False, "cut off"),
        ("1.038", Recomputed(1.039, rounding=0.001), False, "rounding of the printed inputs"),
        (".0122", Recomputed(0.121), False, "decimal point"),
        ("0.992", Recomputed(0.99701, hint="as elsewhere"), False, "as elsewhere; differs by -0.00501"),
        ("0.5", Recomputed(None, note="never tabulated"), None, "never tabulated"),
        ("", Recomputed(0.7, note="lost"), None, "lost"),
    ],
)
def test_a_line_says_how_it_differs(printed: str, found: Recomputed, agreed: bool | None, note: str) -> None:
    result = line("5.0", 1, "something", printed, found)
    assert result.agrees is agreed
    assert note in result.note
    assert bool(result.note) == bool(note)
