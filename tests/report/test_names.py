"""Names from the data are text: in a figure as much as on a page."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayestissue.reports.figures.intervals import intervals
from bayestissue.reports.figures.study_comparisons import points
from bayestissue.reports.figures.theme import number
from bayestissue.reports.pages.fit.fit_page import page_of
from make_fit_run import changed, fit_run, groups_of

# What may be read as a formula or an expression, or hidden from a legend; what a page would read as HTML.
NAMES = ["$x_{1$", "_x", r"a\b\frac{", "<i>", "long " * 60, "قدم اليسار", "👣", "100 %", "^2_", "x\ny"]


@pytest.mark.slow
def test_no_name_keeps_a_fits_page_from_being_drawn():
    run, told = fit_run(), {}
    groups = groups_of(run)
    for kind in ("impact", "subject", "trial"):
        old = groups["posterior"][kind].to_numpy().astype(str)
        told |= {name: NAMES[k % len(NAMES)] + f" {k}" * (k >= len(NAMES)) for k, name in enumerate(old)}
    for data in groups.values():
        for name, variable in data.variables.items():
            if variable.dtype.kind in "OUT":
                new = np.array([told.get(str(text), str(text)) for text in variable.to_numpy()], object)
                data[name] = variable.dims, new
    tables = {
        name: table.map(lambda cell: told.get(cell, cell) if isinstance(cell, str) else cell)
        for name, table in (run.tables | {"truth": run.truth}).items()
    }
    html = page_of(changed(run, groups=groups, **tables))
    assert "$x_{1$" in html
    assert "<i>" not in html


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
