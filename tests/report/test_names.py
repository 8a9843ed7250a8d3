"""Names from the data are text: in a figure as much as on a page."""

from __future__ import annotations

import pandas as pd

from bayestissue.reports.figures.intervals import intervals
from bayestissue.reports.figures.study_comparisons import points
from bayestissue.reports.figures.theme import number


def test_a_legend_shows_names_as_they_are():
    rows = pd.DataFrame({"x": [1.0, 2.0], "y": [1.0, 2.0], "kind": ["_x", "$x_{1$"]})
    drawn = points(rows, number("x", "x (m)"), number("y", "y (m)"), "two points").svg()
    assert ">_x</text>" in drawn
    assert ">$x_{1$</text>" in drawn


def test_a_long_name_keeps_both_ends():
    rows = pd.DataFrame({"label": ["a" * 40 + "z" * 40, "heel"], "value": [1.0, 2.0]})
    drawn = intervals(rows, "K (N/m)", "two values").svg()
    assert ">" + "a" * 13 + "…" + "z" * 14 + "</text>" in drawn
    assert ">heel</text>" in drawn
