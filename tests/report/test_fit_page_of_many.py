"""The page of a fit of many impacts, of which some draws and some predictions were kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.reports.pages import write_report
from make_fit_run import make_fit_run
from tree_file import write_tree

pytestmark = pytest.mark.slow

KEPT = [0, 20, 40, 60, 80]


def of_many(folder: Path) -> Path:
    """As `bayestissue fit` writes many impacts: their draws along kept_draw, a third of them predicted."""
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        groups = {name: tree[name].to_dataset().load() for name in tree.children}
    posterior = groups["posterior"]
    single = [name for name, array in posterior.data_vars.items() if "impact" in array.dims]
    kept = posterior[single].isel(draw=KEPT).rename(draw="kept_draw").assign_coords(kept_draw=KEPT)
    groups["posterior"] = posterior.drop_vars(single).drop_dims("impact", errors="ignore").merge(kept)
    for name in ("posterior_predictive", "observed_data"):
        groups[name] = groups[name].isel(impact=slice(0, None, 3))
    write_tree(groups, folder / "posterior.nc")
    summary = pd.read_csv(folder / "summary.csv")
    summary.loc[summary["variable"].isin(single), ["ess_bulk", "ess_tail", "r_hat"]] = np.nan
    summary.to_csv(folder / "summary.csv", index=False)
    about = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    about["kept_draws_of_an_impact"] = 2 * len(KEPT)
    (folder / "run.json").write_text(json.dumps(about), encoding="utf-8")
    return folder


def test_the_page_says_what_was_kept(tmp_path: Path) -> None:
    html = write_report(of_many(make_fit_run(tmp_path))).read_text(encoding="utf-8")
    assert "Of each of them 10 draws are kept" in html
    assert "of 4 evenly spaced impacts" in html
    assert "Of 12 impacts 4, evenly spaced, are tested." in html
