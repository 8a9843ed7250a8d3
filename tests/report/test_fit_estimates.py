"""Estimates beside the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.report.fit.estimates import side_by_side
from bayestissue.report.fit.run import read_fit_run
from make_fit_run import make_fit_run


def test_side_by_side_is_held_against_the_other_element_s_secant_stiffness(
    tmp_path: Path,
) -> None:
    folder = make_fit_run(tmp_path / "run")
    about = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    path = folder / "truth.csv"
    truth = pd.read_csv(path)
    truth.assign(K_secant_N_per_m=2 * truth["K_N_per_m"]).to_csv(path, index=False)
    run = read_fit_run(folder, about)
    np.testing.assert_array_equal(side_by_side(run, "K")["truth"], 2 * truth["K_N_per_m"])
    np.testing.assert_array_equal(side_by_side(run, "C")["truth"], truth["C_N_s_per_m"])
    about["model"]["element"] = "maxwell"
    np.testing.assert_array_equal(side_by_side(read_fit_run(folder, about), "K")["truth"], truth["K_N_per_m"])
