"""Masses that are tapped: K, C and the mass of a simulated study, and what no such fit can have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bayestissue as bt
from bayestissue.errors import InputError
from bayestissue.fitting import resolve
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.inference.factors.expansions import expanded
from bayestissue.inference.factors.noise_left import noise_p
from bayestissue.simulation import Campaign, Simulation, simulate

MASSES = (0.8, 1.4, 2.4)


def study(seed: int, **recording: Any) -> Campaign:
    """Five people, three masses, two taps each."""
    content = {
        "name": "taps",
        "seed": seed,
        "design": {
            "subjects": 5,
            "repeats": 2,
            "conditions": [{"trial": f"{m:g} kg", "mass_kg": m, "impulse_N_s": 0.4} for m in MASSES],
        },
        "tissue": {
            **{"K_N_per_m": 4000.0, "C_N_s_per_m": 9.0, "reference_mass_kg": 1.4},
            **{"sd_subject_K": 0.2, "sd_subject_C": 0.2, "sd_impact_K": 0.05, "sd_impact_C": 0.05},
        },
        "tap": {"duration_s": 0.006},
        "recording": {
            **{"sampling_rate_hz": 5000.0, "noise_sd_m_s2": 0.02, "offset_sd_m_s2": 0.1},
            **recording,
            "force": {"place": "hammer", "noise_sd_N": 0.1, "relative_gain_sd": 0.005},
        },
    }
    return simulate(Simulation.model_validate(content))


def test_expansions_have_the_truth_and_residuals_are_noise() -> None:
    made = study(3, mass_factor=1.2, relative_mass_sd=0.3)
    model, source = resolve("tapped", "tapped")
    prepared = prepare(made.dataset("taps"), model, source=source)
    sites, truth = expanded(prepared), made.truth
    u, covariance = np.asarray(sites.centre), np.linalg.inv(np.asarray(sites.precision))
    # At the recorded mass K and C are less by m / M, which a has with both gains.
    ratio = np.log(truth["mass_kg"].to_numpy() / prepared.signal.mass)
    true_K, true_C = (np.log(truth[name].to_numpy()) - ratio for name in ("K_N_per_m", "C_N_s_per_m"))
    a = ratio + np.log(truth["force_gain"].to_numpy() / truth["gain"].to_numpy())
    error = np.stack([u[:, 0] - true_K, u[:, 1] - true_C, u[:, 3] - a], axis=1)
    z = error / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, [0, 1, 3]])
    # A chi-square of 30 each is within 4 of its standard deviations; the sum over the force's samples errs by
    # less than the standard deviation that it is given.
    assert ((z**2).sum(0) < 30 + 4 * np.sqrt(60)).all()
    assert np.abs(z.mean(0)).max() < 4 / np.sqrt(30)
    p = noise_p(prepared.model, prepared.data, u)
    assert (p < 0.01).sum() <= 3


def test_a_model_of_another_motion_is_refused() -> None:
    made = study(1)
    with pytest.raises(InputError, match='"tapped", since the force is a hammer'):
        bt.fit(made.dataset("taps"), "impact")
    with pytest.raises(InputError, match="single estimates"):
        bt.estimate(made.dataset("taps"))
    accelerations = made.dataset("taps")
    with pytest.raises(InputError, match='no channel says place = "hammer"'):
        bt.fit(simulate(Simulation.model_validate(HIT)).dataset("hits"), "tapped")
    assert accelerations.tapped


HIT = {
    "name": "hits",
    "design": {"subjects": 2, "conditions": [{"trial": "a", "mass_kg": 0.7, "velocity_m_s": 1.0}]},
    "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 20.0},
}


def test_check_has_taps_and_no_impacts() -> None:
    found = bt.check(study(2).dataset("taps"))
    assert found.verdict == "fine"
    assert found.force is None
    assert found.quality["samples_in_window"].min() > 8


@pytest.mark.slow
def test_a_fit_finds_masses_that_are_a_tenth_wrong(tmp_path: Path) -> None:
    made = study(5, mass_factor=1.1, relative_mass_sd=0.05)
    model = {"like": "tapped", "sampler": {"effective": 200, "draws": 500}}
    fit = bt.fit(made.dataset("taps"), model)
    posterior, truth = fit.posterior["posterior"].dataset, made.truth
    assert fit.diagnostics["passed"]
    held = {}
    for name, column in {"K": "K_N_per_m", "C": "C_N_s_per_m", "mass": "mass_kg"}.items():
        low, high = posterior[name].quantile([0.005, 0.995], ("chain", "draw")).to_numpy()
        true = truth[column].to_numpy()
        held[name] = ((low <= true) & (true <= high)).mean()
    # One gain is common to all: 99 % intervals hold all of them or, once in a hundred, hardly any.
    assert min(held.values()) > 0.9
    factor = posterior["mass_factor"].quantile([0.005, 0.995], ("chain", "draw")).to_numpy()
    assert factor[0] < 1.1 < factor[1]
    # Two errors of gain of 0.5 %, and nothing else that is common.
    assert np.log(factor[1] / factor[0]) < 2 * 2.576 * 0.011
    assert "all masses are" in fit.diagnostics["channels"]["first"]
    fit.report(tmp_path / "report.html")
    assert "rests on a spring and damper" in (tmp_path / "report.html").read_text()
