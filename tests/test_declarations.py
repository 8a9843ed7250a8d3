"""Sentences with numbers in them."""

import pytest

from bayestissue.base.declarations import filled, general


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (50003.0, 4, "50000"), (50003.0, 1, "50000"), (120.0, 2, "120"), (95000.0, 2, "95000"),
        (-1234.0, 2, "-1200"), (0.12345, 2, "0.12"), (5.0, 4, "5"), (2.5e7, 2, "2.5e+07"),
        (3e-7, 2, "3e-07"), (999_999.0, 2, "1000000"), (1, 2, "1"), (float("inf"), 2, "inf"),
    ],
)  # fmt: skip
def test_no_number_below_a_million_has_an_exponent(value: float, digits: int, text: str) -> None:
    assert general(value, digits) == text
    assert filled(f"{{value:.{digits}g}} %", value=value) == f"{text} %"


def test_a_sentence_is_else_as_python_fills_it() -> None:
    sentence = "{name} {share:.1%} {table[K]:.2f} {number:6.1f}|{e:.1e}"
    values = {"name": "g", "share": 0.123, "table": {"K": 1.234}, "number": 3.0, "e": 120.0}
    assert filled(sentence, **values) == sentence.format(**values)
