"""Names from the data are text: in a figure as much as on a page."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.report import write_report
from bayestissue.report.page import figure
from bayestissue.report.style import label_in_powers, new_figure, power_of_ten, shown, style
from make_fit_run import make_fit_run
from tree_file import write_tree

# What matplotlib would read as a formula, hide from a legend, or warn of; what a page would read as HTML.
NAMES = ["$x_{1$", "_x", r"a\b\frac{", "<b>", "long " * 60, "قدم اليسار", "👣", "100 %", "^2_", "x\ny"]

pytestmark = pytest.mark.usefixtures("drawn")


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


def test_no_name_keeps_a_fits_page_from_being_drawn(tmp_path):
    html = write_report(renamed(make_fit_run(tmp_path / "run"))).read_text(encoding="utf-8")
    assert "$x_{1$" in html
    assert "<b>" not in html
    # A number on a logarithmic axis is plain text too.
    assert "mathdefault" not in html


def test_a_legend_shows_a_name_that_begins_with_an_underscore():
    with style():
        fig, axes = new_figure()
        axes.plot([0, 1], label=shown("_x"))
        fig.legend()
        assert "_x</text>" in figure(fig, "a line")


def test_a_long_name_keeps_both_ends():
    assert shown("a" * 40 + "z" * 40) == "a" * 13 + "…" + "z" * 14
    assert shown("heel") == "heel"


@pytest.mark.parametrize(
    ("value", "text"), [(1e-3, "10⁻³"), (1.0, "10⁰"), (2e5, "2·10⁵"), (5e-10, "5·10⁻¹⁰")]
)
def test_powers_of_ten_are_plain_text(value, text):
    assert power_of_ten(value) == text


def test_a_logarithmic_axis_is_labelled_without_formulas():
    with style():
        fig, axes = new_figure()
        axes.loglog([1e-12, 1], [0.2, 0.9])
        for axis in (axes.xaxis, axes.yaxis):
            label_in_powers(axis)
        drawn = figure(fig, "a line")
    assert "10⁰</text>" in drawn
    assert "mathdefault" not in drawn
