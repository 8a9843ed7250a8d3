from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayestissue.reports.pages import wording


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (17.92, 19.18, "17.9 to 19.2"),
        (0.9312, 0.9961, "0.931 to 0.996"),
        (2640.0, 3560.0, "2640 to 3560"),
        (-0.21, 0.38, "−0.21 to 0.38"),
        (2.0, 2.0, "2.000 to 2.000"),
    ],
)
def test_an_interval_shows_two_digits_of_its_width(low, high, expected):
    assert wording.interval(low, high) == expected


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ((50003.0, 48211.0, 51790.0), ("50000", "48200", "51800")),
        ((50003.0, 50001.2, 50004.9), ("50003.0", "50001.2", "50004.9")),
        ((312345.0, 0.0, 912345.0), ("310000", "0", "910000")),
        ((50003.0, 50003.0, 50003.0), ("50000", "50000", "50000")),
        ((0.0123456, 0.01234, 0.01235), ("0.01235", "0.01234", "0.01235")),
        ((1.5, 1.25, math.inf), ("1.500", "1.250", "inf")),
        ((math.nan, 0.0, 2.0), ("nan", "0", "2.000")),
    ],
)
def test_a_median_and_its_interval(numbers, expected):
    assert wording.estimated(*numbers) == expected


@given(st.floats(-1e6, 1e6), st.floats(1e-4, 1e6))
def test_rounding_moves_an_end_by_at_most_a_tenth_of_the_width(low, width):
    decimals = wording.decimals_of(width)
    shown = float(wording.number(low, decimals).replace("−", "-"))
    # Two digits of the width: half a unit of the second is at most a twentieth of it (width 1.0),
    # and one thousandth of a unit is left for the rounding of the sum itself.
    assert abs(shown - low) <= max(0.05 * width, 0.5 * 10.0**-decimals) * 1.001


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.00123456, "0.00123"),
        (23.21, "23.2"),
        (1336.4, "1340"),
        (-0.5, "−0.500"),
        (0.0, "0"),
        (1e-9, "1.00e−9"),
    ],
)
def test_significant_digits(value, expected):
    assert wording.significant(value).replace("e−09", "e−9") == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.0, "below 0.001"), (0.0042, "0.004"), (0.468, "0.47"), (0.9951, "0.995"), (1.0, "above 0.999")],
)
def test_a_probability_claims_no_more_than_draws_can_tell(value, expected):
    assert wording.probability(value) == expected


@pytest.mark.parametrize(
    "function", [wording.probability, wording.percent, wording.significant, lambda x: wording.number(x, 2)]
)
def test_what_is_not_a_number_is_said_to_be_unknown(function):
    assert function(math.nan) == "not known"


def test_there_is_no_negative_zero():
    assert wording.number(-0.001, 2) == "0.00"


@pytest.mark.parametrize(
    ("ratio", "expected"), [(0.0161, "1.6 %"), (0.0996, "10 %"), (0.58, "58 %"), (1e-5, "below 0.1 %")]
)
def test_percentages(ratio, expected):
    assert wording.percent(ratio).replace("\N{NO-BREAK SPACE}", " ") == expected


@pytest.mark.parametrize(
    ("words", "expected"), [([], ""), (["a"], "a"), (["a", "b"], "a and b"), (["a", "b", "c"], "a, b and c")]
)
def test_lists_read_as_sentences(words, expected):
    assert wording.listed(words) == expected


def test_words_for_probabilities_are_in_order():
    said = [wording.likelihood_words(value) for value in (0.995, 0.95, 0.8, 0.5, 0.2, 0.05, 0.001)]
    assert said[0] == "almost certainly"
    assert said[-1] == "almost certainly not"
    assert len(set(said)) == len(said)


@pytest.mark.parametrize(
    ("ratio", "expected"),
    [
        (0.063, "±6.3 %"),
        (0.49, "±49 %"),
        (1.71, "a factor of 2.7"),
        (math.inf, "not known"),
        (math.nan, "not known"),
    ],
)
def test_a_wide_relative_spread_is_a_factor(ratio, expected):
    assert wording.relative(ratio).replace("\N{NO-BREAK SPACE}", " ") == expected
