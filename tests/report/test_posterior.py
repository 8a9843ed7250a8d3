from __future__ import annotations

import numpy as np
import pytest

from bayestissue.report.posterior import Spread
from bayestissue.report.style import log_ticks, new_figure, style


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


@pytest.mark.parametrize(("values", "some", "none"), [((0.4, 1.3), 0.7, 0.75), ((300, 2e5), 5000, 7000)])
def test_a_log_axis_is_labelled_where_there_is_room(values, some, none):
    with style():
        _, axes = new_figure()
        axes.semilogy(range(len(values)), values)
        log_ticks(axes.yaxis, values)
        labelled = list(axes.get_yticks())
        shown = axes.yaxis.get_major_formatter().format_ticks([some])
    assert np.isclose(labelled, some).any()
    assert not np.isclose(labelled, none).any()
    assert shown == [f"{some:g}"]
