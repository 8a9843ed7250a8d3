from __future__ import annotations

import numpy as np
import pytest

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.relations import correlation_figure, mass_figure


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
    figure = mass_figure(published, "C")
    assert (len(figure.impacts), len(figure.averages)) == (70, 9)
    assert (figure.printed_constant, figure.printed_slope) == (-0.444, 2.962)
    assert figure.constant == pytest.approx(-0.4435, abs=5e-5)
    assert figure.slope == pytest.approx(2.9631, abs=5e-5)
    assert figure.impacts["value"].equals(published.estimates["C"].rename("value"))
