"""Sharply recorded tissue that stiffens: sites at one place describe it badly."""

from __future__ import annotations

import itertools

import pytest

from bayestissue.base import resources
from bayestissue.inference.fit import fit_traces
from bayestissue.model.hierarchy.specification import read_specification
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.studies.simulation import Campaign
from campaigns import simulated, spreads


def campaign(seed: int) -> Campaign:
    """72 impacts of six people."""
    masses, velocities = zip(*itertools.product((0.4, 0.7, 1.1, 1.3), (1.25, 1.5, 1.75)), strict=True)
    tissue = {
        "element": "stiffening",
        "K_N_per_m": 4200.0,
        "C_N_s_per_m": 18.0,
        "parameters": {"stiffening_depth_m": 0.02},
        **spreads(subject=0.2, trial=0.05),
        **{"sd_impact_K": 0.05, "sd_impact_C": 0.1},
    }
    recording = {
        "sampling_rate_hz": 5000.0,
        "noise_sd_m_s2": 0.6,
        "velocity_sd_m_s": 0.01,
        "relative_mass_sd": 0.002,
    }
    return simulated(tissue, recording, people=6, masses=masses, velocity=velocities, seed=seed)


@pytest.mark.long
def test_a_further_parameter_that_all_impacts_nearly_share() -> None:
    """72 impacts of one further parameter: all but known, and nearly the same in all of them."""
    made = campaign(1)
    specification = read_specification(resources.shared("models", "stiffening.toml"))
    given = prepare(made.dataset("stiffening"), specification, source="the model file")
    found = fit_traces(given, specification, 0, lambda *_: None)
    assert found.diagnostics["passed"], found.diagnostics["checks"]
    depth = found.tree["posterior"].dataset["stiffening_depth_m"].mean(("chain", "draw"))
    # Each impact's depth is known to two hundredths; pooled, far better.
    assert abs(float(depth.mean()) / 0.02 - 1) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 3])
def test_a_wrong_element_beside_a_discrepancy_passes(seed: int) -> None:
    """A spring and damper, whose likelihoods are far from normal."""
    specification = read_specification(resources.shared("models", "impact.toml"))
    specification = specification.model_copy(update={"discrepancy": "always"})
    given = prepare(campaign(seed).dataset("stiffening"), specification, source="the model file")
    found = fit_traces(given, specification, 0, lambda *_: None)
    assert found.diagnostics["passed"], found.diagnostics["checks"]
