"""The recorded heel strikes, fitted from end to end by the model file that is made for them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from bayestissue.cli import app
from bayestissue.resources import shared

PEOPLE = 11
# Half of a normal 90 % interval, in standard deviations.
HALF_90 = 1.6449


@pytest.mark.long
def test_heel_strikes_are_fitted_and_people_ranked(heel_strikes: Path, tmp_path: Path) -> None:
    out = tmp_path / "fit"
    model = shared("models", "heelstrike.toml")
    done = CliRunner().invoke(
        app, ["fit", str(heel_strikes), "--model", str(model), "--out", str(out), "--quiet"]
    )
    diagnostics = json.loads((out / "diagnostics.json").read_text(encoding="utf-8"))
    assert done.exit_code == 0, [check for check in diagnostics["checks"] if not check["passed"]]
    summary = pd.read_csv(out / "summary.csv")
    K = summary[summary["variable"] == "K_subject"].set_index("label")
    assert len(K) == PEOPLE
    # The mass's error of 20 % is a person's; what is known of other people takes a little of it off:
    # 1 / variance = 1 / 0.2^2 + 1 / sd_subject_K^2 + 1 / sd_subject_C^2, the population's mean given.
    spreads = summary[summary["variable"].isin(["sd_subject_K", "sd_subject_C"])]["median"]
    least = 1 / np.sqrt(0.2**-2 + (spreads**-2).sum())
    half = np.log(K["eti90_high"] / K["eti90_low"]) / 2 / HALF_90
    # An interval's end has a Monte Carlo error; a tenth is far more than that of 1000 effective draws.
    assert (half > 0.9 * least).all()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "ranked: posterior median" in page
    assert "no surer than that mass" in page
    assert all(person in page for person in K.index)
