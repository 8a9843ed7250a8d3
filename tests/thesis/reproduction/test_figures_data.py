from __future__ import annotations

import numpy as np
import pytest

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.conditions import conditions
from bayestissue.thesis.reproduction.relations import correlation_figure, printed_line, straight_line


@pytest.mark.parametrize(
    ("quantity", "averages", "count"), [("K", False, 13), ("C", False, 10), ("K", True, 12), ("C", True, 12)]
)
def test_bars_fall(published: PublishedTables, quantity: str, averages: bool, count: int) -> None:
    figure = correlation_figure(published, quantity, averages=averages)  # type: ignore[arg-type]
    assert len(figure) == count
    assert figure["absolute"].is_monotonic_decreasing
    assert figure["variable"].iloc[0] == "Mass"
    known = figure.dropna(subset="correlation")
    np.testing.assert_array_equal(known["absolute"], known["correlation"].abs())
    both = known.dropna(subset="published")
    # printed correlations are cut to three decimals
    assert ((both["correlation"] - both["published"]).abs() < 1e-3).all()


def test_mass_figures(published: PublishedTables) -> None:
    table = conditions(published, "C")
    assert (len(published.estimates), len(table)) == (70, 9)
    assert printed_line(published, "C") == (-0.444, 2.962)
    refitted = straight_line(table).params
    assert refitted["const"] == pytest.approx(-0.4435, abs=5e-5)
    assert refitted["Mass"] == pytest.approx(2.9631, abs=5e-5)
