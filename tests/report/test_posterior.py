from __future__ import annotations

import pytest

from bayestissue.reports.pages.wording import Spread


@pytest.mark.parametrize(
    ("spread", "value", "words"),
    [
        (Spread(2699, 1789, 3910), "2700", "1800 to 3900"),
        (Spread(3.84, 0.251, 73.2), "3.8", "0.25 to 73"),
        (Spread(0.017, -0.013, 0.047), "0.017", "−0.013 to 0.047"),
    ],
)
def test_ends_that_differ_tenfold_have_digits_of_their_own(spread, value, words):
    assert (spread.value, spread.range) == (value, words)
