"""A simulated pendulum with a load cell, its masses declared too small: the posterior has what they are."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import bayestissue as bt
from bayestissue.inference.checking.findings import FORCE_CONTRADICTS
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.studies.simulation import Campaign, Simulation, simulate
from campaigns import COLUMNS, FOUR_BY_FOUR, holds

pytestmark = pytest.mark.slow

FACTOR = 1.1
ALL = ("K", "C", "mass_kg")
CELL = {"noise_relative_to_peak": 0.005, "relative_gain_sd": 0.01}
DECLARED = Uncertainty(relative_mass_sd=0.1, velocity_sd_m_s=0.005, relative_gain_sd=0.002, offset_sd=0.0)


def recorded(factor: float, tip: float = 0.0) -> Campaign:
    """Four people in four conditions, with a load cell, masses declared too small by a factor."""
    four = tomllib.loads(FOUR_BY_FOUR)
    force = CELL | {"tip_mass_kg": tip}
    four["recording"] |= {"mass_factor": factor, "relative_gain_sd": 0.002, "force": force}
    return simulate(Simulation.model_validate(four))


def told(posterior: xr.Dataset, name: str, truth: float) -> None:
    """An interval holds the truth, and is as wide as one gain of 1 % leaves it: 3.3 % from 5 to 95 %."""
    low, high = np.quantile(posterior[name], [0.05, 0.95])
    assert low < truth < high, name
    assert 0.02 < high - low < 0.05, name


def test_masses_that_are_declared_too_small_are_put_right() -> None:
    made = recorded(FACTOR, tip=0.1)
    # What the lab declares of the mass: a tenth.
    fit = bt.fit(made.dataset("made").with_settings(uncertainty=DECLARED), seed=1)
    posterior = fit.posterior["posterior"].dataset
    told(posterior, "mass_factor", FACTOR)
    # Only their product with the masses' factor shows: the load cell's gain is known as well as the masses.
    told(posterior, "gain_factor", made.truth["force_gain"].mean() / made.truth["gain"].mean())
    # All impacts share the gain's error; so nearly all intervals hold, or none.
    holds(posterior.rename(mass="mass_kg"), made.truth, ALL, least=13 / 16)
    for name, column in (*COLUMNS.items(), ("mass", "mass_kg")):
        # At the declared mass every one of them would be 10 % off.
        z = np.log(posterior[name] / made.truth[column].to_numpy()[None, None])
        assert abs(float(z.mean())) < 0.03
    assert fit.diagnostics["channels"]["passed"]
    assert fit.diagnostics["channels"]["follows"]
    predicted, observed = (fit.posterior[name].dataset for name in ("posterior_predictive", "observed_data"))
    recorded_force = observed["force"].to_numpy()
    known = np.isfinite(recorded_force)
    low, high = np.percentile(predicted["force"].to_numpy()[..., known], [5, 95], axis=(0, 1))
    inside = ((low < recorded_force[known]) & (recorded_force[known] < high)).mean()
    # Replicates have errors of the chain from the prior: they scatter more than the noise alone.
    assert inside > 0.85
    assert "force" in fit.posterior["prior_predictive"].dataset
    assert "all masses are 1." in fit.about["verdict"]["headline"]


def test_a_force_of_another_law_is_said_on_the_first_line_and_on_the_page(tmp_path: Path) -> None:
    made = recorded(1.0).dataset("made").with_settings(uncertainty=DECLARED)
    (forces,) = made.further
    # A cell that reads more the more it is pressed; the deceleration is that of the spring and damper.
    bent = [
        replace(trace, value=trace.value * (1 + 0.1 * (trace.value / trace.value.max()) ** 2))
        for trace in forces
    ]
    fit = bt.fit(replace(made, further=(bent,)), seed=1)
    account, form = fit.diagnostics["channels"], fit.diagnostics["model_form"]
    assert not form["structured"]
    assert not form["impacts"]["structured"]
    assert not account["follows"]
    assert "The force of the channel force does not follow the law" in account["words"]
    assert (fit.summary.loc[fit.summary["variable"] == "K", "note"] != "").all()
    fit.report(tmp_path / "report")
    page = (tmp_path / "report" / "report.html").read_text()
    assert "does not follow the law that the deceleration does" in page


def test_masses_that_the_force_contradicts_are_noted_on_every_row() -> None:
    # Masses are declared as exact to 0.2 %, and are a tenth off.
    exact = DECLARED.model_copy(update={"relative_mass_sd": 0.002})
    fit = bt.fit(recorded(FACTOR).dataset("made").with_settings(uncertainty=exact), seed=1)
    assert fit.diagnostics["channels"]["agrees"] is False
    assert (fit.summary["note"] == FORCE_CONTRADICTS).all()
