"""Tissue that moves along: what tells its mass, and what the program says where nothing does."""

from __future__ import annotations

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.studies.simulation import Campaign
from campaigns import RECORDER, holds, simulated, spreads

RECORDING = RECORDER | {"velocity_sd_m_s": 0.015, "offset_sd_m_s2": 0.0}
PLATE = {"noise_relative_to_peak": 0.005, "relative_gain_sd": 0.01, "place": "base"}
SHORT = {"like": "moving_mass", "sampler": {"chains": 2, "draws": 500, "effective": 400}}
ALL = ("K", "C", "moving_mass_kg")


def campaign(masses: tuple[float, ...], moves: float = 0.1, **recording: object) -> Campaign:
    tissue = {"element": "moving_mass", "parameters": {"moving_mass_kg": moves}}
    tissue |= spreads(subject=0.2, impact=0.05)
    return simulated(tissue, RECORDING | recording, people=3, masses=masses, seed=1)


def half_width(fit: bt.Fit) -> float:
    """Of the 90 % interval of m's mean over impacts, in units of m."""
    low, high = np.quantile(fit.posterior["posterior"]["log_moving_mass_kg_mean"], [0.05, 0.95])
    return float(high - low) / 2


@pytest.mark.slow
def test_with_a_force_below_the_tissue_its_mass_is_found() -> None:
    made = campaign((0.5, 1.0), force=PLATE)
    fit = bt.fit(made.dataset("moving"), SHORT, seed=1)
    holds(fit.posterior["posterior"].dataset, made.truth, ALL, least=0.8)
    # A gain of 1.1 % is one of m / (M + m), 0.17 to 0.09; both masses tell it.
    assert half_width(fit) < 0.2
    added = fit.diagnostics["added_mass"]
    assert (added["by"], added["passed"]) == ("force", True)
    assert fit.diagnostics["channels"]["passed"]
    assert fit.about["verdict"]["headline"] == "Diagnostics passed."


@pytest.mark.long
def test_without_it_the_velocity_tells_it_as_well_as_it_is_known() -> None:
    made = campaign((0.5,))
    fit = bt.fit(made.dataset("moving"), SHORT, seed=1)
    holds(fit.posterior["posterior"].dataset, made.truth, ALL, least=0.6)
    # 1.1 % of (M + m) / m in one standard deviation, however many impacts.
    assert 0.08 < half_width(fit) < 0.25
    assert "rests on the stated velocities" in fit.about["verdict"]["headline"]


@pytest.mark.long
def test_with_a_velocity_that_is_hardly_known_it_is_what_its_prior_says_and_that_is_said() -> None:
    made = campaign((0.5,), moves=0.05)
    unsure = made.dataset("moving").with_settings(
        uncertainty=Uncertainty(
            relative_mass_sd=0.002, velocity_sd_m_s=0.45, relative_gain_sd=0.03, offset_sd=0.0
        )
    )
    # Along the bent ridge of m and K the chains may not pass.
    hardly = bt.fit(unsure, SHORT, seed=1)
    added = hardly.diagnostics["added_mass"]
    assert not added["passed"]
    assert added["overlap"] > 0.5
    first = hardly.about["verdict"]["headline"]
    assert "largely what its prior says" in first or "do not use these numbers" in first
    assert "The recordings hardly tell moving_mass_kg" in hardly.about["verdict"]["words"]
