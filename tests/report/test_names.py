"""Names from the data are text: in a figure as much as on a page."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.reports.figures.intervals import intervals
from bayestissue.reports.figures.study_comparisons import points
from bayestissue.reports.figures.theme import number
from bayestissue.reports.pages import write_report
from make_fit_run import make_fit_run
from tree_file import write_tree

# What may be read as a formula or an expression, or hidden from a legend; what a page would read as HTML.
NAMES = ["$x_{1$", "_x", r"a\b\frac{", "<i>", "long " * 60, "قدم اليسار", "👣", "100 %", "^2_", "x\ny"]


def renamed(folder):
    """The run with every impact, person and condition called by one of those names."""
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as stored:
        tree = stored.load()
    groups, told = {}, {}
    for group in tree.children:
        data = tree[group].to_dataset()
        for dimension in ("impact", "subject", "trial"):
            if dimension in data.coords:
                old = [str(each) for each in data[dimension].to_numpy()]
                new = [NAMES[k % len(NAMES)] + (f" {k}" if k >= len(NAMES) else "") for k in range(len(old))]
                told |= dict(zip(old, new, strict=True))
                data = data.assign_coords({dimension: np.array(new, dtype=object)})
        groups[group] = data
    tree.close()
    for data in groups.values():
        for name in ("impact_subject", "impact_trial"):
            if name in data:
                data[name] = (
                    data[name].dims,
                    np.array([told[str(v)] for v in data[name].to_numpy()], object),
                )
    write_tree(groups, folder / "posterior.nc")
    for path in folder.glob("*.csv"):
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        table.map(lambda cell: told.get(cell, cell)).to_csv(path, index=False)
    return folder


@pytest.mark.slow
def test_no_name_keeps_a_fits_page_from_being_drawn(tmp_path):
    html = write_report(renamed(make_fit_run(tmp_path / "run"))).read_text(encoding="utf-8")
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
