"""Levels, formulas and columns with a slash, of which files have no names."""

from __future__ import annotations

import numpy as np
import xarray as xr

from bayestissue.inference.answers.questions import ask, numbered
from bayestissue.inference.answers.study import Study
from designs import any_draws, design_of, impacts

FORMULA = "{1 / mass_kg} + side + (`t/s`|subject) + (1|subject:side)"


def test_they_are_kept_in_a_file_and_asked_of(tmp_path):
    rows = impacts().assign(velocity_m_s=1.5)
    rows["side"] = rows["side"].map({"left": "n/a", "right": "pre/post: 'x' \"y\""})
    rows["t/s"] = np.random.default_rng(0).uniform(size=len(rows))
    design, rng = design_of(FORMULA, "1", rows=rows), np.random.default_rng(1)
    draws = any_draws(design, rng, (2, 200))
    xr.DataTree.from_dict({"posterior": draws}).to_netcdf(tmp_path / "p.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "p.nc", engine="h5netcdf") as tree:
        read = tree["posterior"].to_dataset().load()
    xr.testing.assert_equal(read[list(draws)], draws)
    assert all("long_name" in read[name].attrs for name in read if "effect_of" in str(name))
    asked = numbered(["`effect_of_I(1 / mass_kg)_K`", 'K[side="n/a"] / K', "`sd_subject_effect_of_t/s_K`"])
    answers = ask(Study(read, design.recorded), asked)
    assert answers["median"].notna().all()
    expected = np.median(draws["effect_of_I(1 \N{DIVISION SLASH} mass_kg)_K"])
    np.testing.assert_allclose(answers["median"][0], expected)
