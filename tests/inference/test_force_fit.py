"""A simulated pendulum with a load cell, its masses declared too small: the posterior has what they are."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayestissue as bt
from bayestissue.inference.checking.findings import FORCE_CONTRADICTS
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.studies.simulation import Simulation, simulate
from campaigns import FOUR_BY_FOUR

pytestmark = pytest.mark.slow

FACTOR = 1.1


@pytest.mark.parametrize("tip", [0.0, 0.1])
def test_masses_that_are_declared_too_small_are_put_right(tip: float) -> None:
    content = tomllib.loads(FOUR_BY_FOUR)
    content["recording"] |= {
        "mass_factor": FACTOR,
        "relative_gain_sd": 0.002,
        "force": {"noise_relative_to_peak": 0.005, "relative_gain_sd": 0.01, "tip_mass_kg": tip},
    }
    made = simulate(Simulation.model_validate(content))
    # What the lab declares of the mass: a tenth.
    dataset = made.dataset("made").with_settings(
        uncertainty=Uncertainty(
            relative_mass_sd=0.1, velocity_sd_m_s=0.005, relative_gain_sd=0.002, offset_sd=0.0
        )
    )
    fit = bt.fit(dataset, seed=1)
    posterior = fit.posterior["posterior"].dataset
    low, high = np.quantile(posterior["mass_factor"], [0.05, 0.95])
    assert low < FACTOR < high
    # One gain of 1 % is all that is left open: 3.3 % from 5 to 95 %.
    assert 0.02 < high - low < 0.05
    # Only their product with the masses' factor shows: the load cell's gain is known as well as the masses.
    gain = made.truth["force_gain"].mean() / made.truth["gain"].mean()
    low, high = np.quantile(posterior["gain_factor"], [0.05, 0.95])
    assert low < gain < high
    assert 0.02 < high - low < 0.05
    for name, column in (("K", "K_N_per_m"), ("C", "C_N_s_per_m"), ("mass", "mass_kg")):
        z = np.log(posterior[name] / made.truth[column].to_numpy()[None, None])
        # All impacts share the gain's error; so nearly all intervals hold, or none.
        assert held(posterior, name, made.truth[column]) > 0.8, name
        # At the declared mass every one of them would be 10 % off.
        assert abs(float(z.mean())) < 0.03
    assert fit.diagnostics["channels"]["passed"]
    assert fit.diagnostics["channels"]["follows"]
    predicted, observed = (fit.posterior[name].dataset for name in ("posterior_predictive", "observed_data"))
    recorded = observed["force"].to_numpy()
    known = np.isfinite(recorded)
    low, high = np.percentile(predicted["force"].to_numpy()[..., known], [5, 95], axis=(0, 1))
    inside = ((low < recorded[known]) & (recorded[known] < high)).mean()
    # Replicates have errors of the chain from the prior: they scatter more than the noise alone.
    assert inside > 0.85
    assert "force" in fit.posterior["prior_predictive"].dataset
    assert "all masses are 1." in fit.about["verdict"]["headline"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "tissue", "recorder"),
    [
        ("hunt_crossley", {"element": "hunt_crossley", "C_N_s_per_m": 60.0}, {}),
        ("impact", {}, {"recorder": {"low_pass_hz": 300.0}}),
    ],
    ids=["a force that rises from 0", "behind a low-pass"],
)
def test_it_is_so_where_a_deceleration_does_not_show_when_contact_was(
    model: str, tissue: dict[str, Any], recorder: dict[str, Any]
) -> None:
    content = tomllib.loads(FOUR_BY_FOUR)
    content["tissue"] |= tissue
    force = {"noise_relative_to_peak": 0.005, "relative_gain_sd": 0.01, "tip_mass_kg": 0.1}
    content |= recorder
    content["recording"] |= {"mass_factor": FACTOR, "relative_gain_sd": 0.002, "force": force}
    made = simulate(Simulation.model_validate(content))
    dataset = made.dataset("made").with_settings(
        uncertainty=Uncertainty(
            relative_mass_sd=0.1, velocity_sd_m_s=0.005, relative_gain_sd=0.002, offset_sd=0.0
        )
    )
    fit = bt.fit(dataset, model=model, seed=1)
    posterior = fit.posterior["posterior"].dataset
    low, high = np.quantile(posterior["mass_factor"], [0.05, 0.95])
    assert low < FACTOR < high
    assert 0.02 < high - low < 0.05
    for name, column in (("K", "K_N_per_m"), ("C", "C_N_s_per_m"), ("mass", "mass_kg")):
        # Of 16 intervals of 90 % fewer than 11 hold the truth once in three hundred studies.
        assert held(posterior, name, made.truth[column]) >= 11 / 16, name
    assert fit.diagnostics["channels"]["passed"]
    assert "force" in fit.posterior["posterior_predictive"].dataset


def held(posterior: xr.Dataset, name: str, truth: pd.Series) -> float:
    """The share of impacts whose 90 % interval holds the truth."""
    low, high = np.quantile(posterior[name], [0.05, 0.95], axis=(0, 1))
    return float(((low < truth) & (truth < high)).mean())


def test_a_force_of_another_law_is_said_on_the_first_line_and_on_the_page(tmp_path: Path) -> None:
    content = tomllib.loads(FOUR_BY_FOUR)
    content["recording"] |= {
        "relative_gain_sd": 0.002,
        "force": {"noise_relative_to_peak": 0.005, "relative_gain_sd": 0.01},
    }
    made = simulate(Simulation.model_validate(content)).dataset("made")
    (forces,) = made.further
    # A cell that reads more the more it is pressed; the deceleration is that of the spring and damper.
    bent = [
        replace(trace, value=trace.value * (1 + 0.1 * (trace.value / trace.value.max()) ** 2))
        for trace in forces
    ]
    uncertainty = Uncertainty(
        relative_mass_sd=0.1, velocity_sd_m_s=0.005, relative_gain_sd=0.002, offset_sd=0.0
    )
    dataset = replace(made.with_settings(uncertainty=uncertainty), further=(bent,))
    fit = bt.fit(dataset, seed=1)
    account, form = fit.diagnostics["channels"], fit.diagnostics["model_form"]
    assert not form["structured"]
    assert not form["impacts"]["structured"]
    assert not account["follows"]
    assert "The force of the channel force does not follow the law" in account["words"]
    assert (fit.summary.loc[fit.summary["variable"] == "K", "note"] != "").all()
    fit.report(tmp_path / "report")
    page = (tmp_path / "report" / "report.html").read_text()
    assert "does not follow the law that the deceleration does" in page
    assert "The force beside the deceleration of one impact (the one with the smallest p)" in page


def test_masses_that_the_force_contradicts_are_noted_on_every_row() -> None:
    content = tomllib.loads(FOUR_BY_FOUR)
    content["recording"] |= {
        "mass_factor": FACTOR,
        "relative_gain_sd": 0.002,
        "force": {"noise_relative_to_peak": 0.005, "relative_gain_sd": 0.01},
    }
    made = simulate(Simulation.model_validate(content)).dataset("made")
    # Masses are declared as exact to 0.2 %, and are a tenth off.
    fit = bt.fit(
        made.with_settings(
            uncertainty=Uncertainty(
                relative_mass_sd=0.002, velocity_sd_m_s=0.005, relative_gain_sd=0.002, offset_sd=0.0
            )
        ),
        seed=1,
    )
    assert fit.diagnostics["channels"]["agrees"] is False
    assert (fit.summary["note"] == FORCE_CONTRADICTS).all()
