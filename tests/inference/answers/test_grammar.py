from __future__ import annotations

import time

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from bayestissue.inference.answers.evaluation import draws_of
from bayestissue.inference.answers.grammar import (
    DEEPEST,
    LONGEST,
    Level,
    Node,
    Number,
    Quantity,
    QuestionError,
    parse,
)
from bayestissue.inference.answers.study import Study
from bayestissue.model.hierarchy.recorded import Recorded
from cases import cases

A, B = np.array([[1.5, -2.0, 3.0]]), np.array([[0.5, 4.0, -1.0]])
DRAWS = xr.Dataset(
    {"a": (("chain", "draw"), A), "b": (("chain", "draw"), B), "chain": [0], "draw": [0, 1, 2]}
)


def worth(text: str) -> np.ndarray:
    return draws_of(parse(text), Study(DRAWS, Recorded(pd.DataFrame(), {}, 1.0))).to_numpy()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 + 2 * 3 ^ 2 / a", 1 + 2 * 3**2 / A),
        ("-a ^ 2", -(A**2)),
        ("2 ** -a − 1e-1", 2**-A - 0.1),
        ("a - b - 1", A - B - 1),
        ("max(a, b, 2) + min(a, b)", np.maximum(np.maximum(A, B), 2) + np.minimum(A, B)),
        ("mean(a, b)", (A + B) / 2),
        ("exp(log(abs(a)))", np.abs(A)),
        ("a > 1 and not b > 0 or a < -1", (A > 1) & ~(B > 0) | (A < -1)),
        ("-1 < a <= 1.5", (A > -1) & (A <= 1.5)),
        ("a between -2 and 2 and b ≥ 1", (np.abs(A) <= 2) & (B >= 1)),
        ("(a) < ((b))", A < B),
        ("3", np.full_like(A, 3)),
    ],
)  # fmt: skip
def test_a_text_is_worth_what_it_says(text: str, expected: np.ndarray) -> None:
    np.testing.assert_allclose(worth(text), expected, rtol=1e-12)


def test_levels_may_be_bare_or_in_quotes() -> None:
    found = parse("""K[subject=s-01.5, "my side"='a ] b', trial]""")
    assert found == Quantity(
        "K",
        (Level("subject", "s-01.5", 2, 10), Level("my side", "a ] b", 18, 28), Level("trial", None, 37, 37)),
        0,
    )
    assert parse("`effect_of_side[right]_K`") == Quantity("effect_of_side[right]_K", (), 0)


@pytest.mark.parametrize(("text", "place"), cases(__file__, "slips"))
def test_a_slip_has_its_place(text: str, place: int) -> None:
    with pytest.raises(QuestionError) as found:
        parse(text)
    assert found.value.position == place


@pytest.mark.parametrize(
    "text",
    [
        "K" * 1_000_000,
        "(" * (LONGEST - 1) + "K",
        "(" * 900 + "K" + ")" * 900 + ")",
        "-" * (LONGEST - 1) + "K",
        "K" + "^2" * 900,
        "K[" + "a=b," * 400 + "]",
    ],
)
def test_hostile_text_is_refused_at_once(text: str) -> None:
    began = time.process_time()
    with pytest.raises(QuestionError):
        parse(text)
    assert time.process_time() - began < 1


def test_parts_may_be_as_deep_as_is_promised() -> None:
    assert worth("-" * (DEEPEST - 1) + "a").shape == A.shape
    assert (worth("(" * 500 + "a" + ")" * 500) == A).all()


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(st.text(max_size=60) | st.text("Kab[]=()+-*/^<>≤'\"`., 0129eandorbetwnlg_", max_size=60))
def test_any_text_is_read_or_refused_with_a_place(text: str) -> None:
    places = []
    try:
        parse(text)
    except QuestionError as slip:
        places = [slip.position]
    assert all(0 <= place <= len(text) for place in places)


@pytest.mark.parametrize(("short", "long"), cases(__file__, "same"))
def test_two_levels_with_over_are_a_ratio_and_of_two_columns_a_ratio_of_ratios(short: str, long: str) -> None:
    assert text(parse(short)) == text(parse(long))


def test_levels_with_over_that_can_not_be_are_refused() -> None:
    with pytest.raises(QuestionError, match="each column once"):
        parse("K[a=p over q, a=p]")
    with pytest.raises(QuestionError, match="at most 4"):
        parse(f"K[{', '.join(f'a{n}=p over q' for n in range(60))}]")


def text(node: Node) -> str:
    """A tree without its positions."""
    if isinstance(node, Number):
        return f"{node.value:g}"
    if isinstance(node, Quantity):
        return f"{node.name}[{', '.join(f'{level.column}={level.value}' for level in node.levels)}]"
    return f"{node.symbol}({', '.join(text(operand) for operand in node.operands)})"
