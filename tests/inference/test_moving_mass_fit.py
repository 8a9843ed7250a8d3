"""Tissue that moves along: what tells its mass, and what the program says where nothing does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

import bayestissue as bt
from bayestissue.inference.checking.mass_checks import judge_added_mass
from campaigns import RECORDER, holds, simulated, spreads

PLATE = {"noise_relative_to_peak": 0.005, "relative_gain_sd": 0.01, "place": "base"}
RECORDING = RECORDER | {"velocity_sd_m_s": 0.015, "offset_sd_m_s2": 0.0, "force": PLATE}
SHORT = {"like": "moving_mass", "sampler": {"chains": 2, "draws": 500, "effective": 400}}


@pytest.mark.parametrize(
    ("sd", "first"), [(0.05, "rests on the stated velocities"), (0.9, "largely what its prior says")]
)
def test_what_tells_it_is_said_where_no_force_does(sd: float, first: str) -> None:
    def drawn(sd: float) -> xr.Dataset:
        log_m = -2 + sd * np.random.default_rng(1).standard_normal((2, 1000))
        return xr.Dataset({"log_moving_mass_kg_mean": (("chain", "draw"), log_m)})

    prepared: Any = SimpleNamespace(model=SimpleNamespace(element="moving_mass"), force=None)
    found = judge_added_mass(prepared, drawn(sd), drawn(1.0))
    assert (found["by"], found["passed"]) == ("velocity", sd < 0.5)
    assert first in found["first"]


@pytest.mark.slow
def test_with_a_force_below_the_tissue_its_mass_is_found() -> None:
    tissue = {"element": "moving_mass", "parameters": {"moving_mass_kg": 0.1}}
    made = simulated(
        tissue | spreads(subject=0.2, impact=0.05), RECORDING, people=3, masses=(0.5, 1.0), seed=1
    )
    fit = bt.fit(made.dataset("moving"), SHORT, seed=1)
    posterior = fit.posterior["posterior"].dataset
    holds(posterior, made.truth, ("K", "C", "moving_mass_kg"), least=0.8)
    low, high = np.quantile(posterior["log_moving_mass_kg_mean"], [0.05, 0.95])
    # A gain of 1.1 % is one of m / (M + m), 0.17 to 0.09; both masses tell it.
    assert high - low < 0.4
    added = fit.diagnostics["added_mass"]
    assert (added["by"], added["passed"]) == ("force", True)
    assert fit.diagnostics["channels"]["passed"]
    assert fit.about["verdict"]["headline"] == "Diagnostics passed."
