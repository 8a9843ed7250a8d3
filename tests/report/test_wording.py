from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayestissue.reports.pages import wording
from bayestissue.reports.pages.wording import Spread


def spread(*numbers: float) -> tuple[str, str]:
    found = Spread(*numbers)
    return found.value, found.range


@pytest.mark.parametrize(
    ("function", "given", "said"),
    [
        # Two digits of the width.
        (wording.interval, (17.92, 19.18), "17.9 to 19.2"),
        (wording.interval, (-0.21, 0.38), "−0.21 to 0.38"),
        (wording.interval, (2.0, 2.0), "2.000 to 2.000"),
        (wording.estimated, (50003.0, 48211.0, 51790.0), ("50000", "48200", "51800")),
        (wording.estimated, (50003.0, 50001.2, 50004.9), ("50003.0", "50001.2", "50004.9")),
        (wording.estimated, (1.5, 1.25, math.inf), ("1.500", "1.250", "inf")),
        (wording.estimated, (math.nan, 0.0, 2.0), ("nan", "0", "2.000")),
        # Ends that differ tenfold have digits of their own.
        (spread, (2699, 1789, 3910), ("2700", "1800 to 3900")),
        (spread, (3.84, 0.251, 73.2), ("3.8", "0.25 to 73")),
        (wording.significant, (0.00123456,), "0.00123"),
        (wording.significant, (1336.4,), "1340"),
        (wording.significant, (-0.5,), "−0.500"),
        (wording.significant, (1e-9,), "1.00e−09"),
        # No more than draws can tell.
        (wording.probability, (0.0,), "below 0.001"),
        (wording.probability, (0.468,), "0.47"),
        (wording.probability, (0.9951,), "0.995"),
        (wording.probability, (1.0,), "above 0.999"),
        (wording.probability, (math.nan,), "not known"),
        (wording.percent, (0.0161,), "1.6 %"),
        (wording.percent, (0.0996,), "10 %"),
        (wording.percent, (1e-5,), "below 0.1 %"),
        (wording.percent, (math.nan,), "not known"),
        (wording.number, (-0.001, 2), "0.00"),
        (wording.listed, (["a", "b", "c"],), "a, b and c"),
        # A wide relative spread is a factor.
        (wording.relative, (0.063,), "±6.3 %"),
        (wording.relative, (1.71,), "a factor of 2.7"),
        (wording.relative, (math.inf,), "not known"),
    ],
)
def test_numbers_in_words(function: Callable[..., object], given: tuple[object, ...], said: object) -> None:
    found = function(*given)
    assert (found.replace("\N{NO-BREAK SPACE}", " ") if isinstance(found, str) else found) == said


@given(st.floats(-1e6, 1e6), st.floats(1e-4, 1e6))
def test_rounding_moves_an_end_by_at_most_a_tenth_of_the_width(low, width):
    decimals = wording.decimals_of(width)
    shown = float(wording.number(low, decimals).replace("−", "-"))
    # Two digits of the width: half a unit of the second is at most a twentieth of it (width 1.0),
    # and one thousandth of a unit is left for the rounding of the sum itself.
    assert abs(shown - low) <= max(0.05 * width, 0.5 * 10.0**-decimals) * 1.001


def test_words_for_probabilities_are_in_order():
    said = [wording.likelihood_words(value) for value in (0.995, 0.95, 0.8, 0.5, 0.2, 0.05, 0.001)]
    assert said[0] == "almost certainly"
    assert said[-1] == "almost certainly not"
    assert len(set(said)) == len(said)
