"""A campaign recorded with autoregressive noise, its correlation and the tissue found again."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

from bayestissue import resources
from bayestissue.dataset import Dataset, Trace
from bayestissue.fitting import fit_prepared
from bayestissue.hierarchy.specification import ModelSpecification, Sampler, read_specification
from bayestissue.hierarchy.trace_data import prepare
from bayestissue.hierarchy.traces import with_normal_errors
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.inference.factors.sites import laplace_sites, weak_prior
from bayestissue.simulation import Campaign, Simulation, simulate

RHO, NOISE = 0.6, 0.005


def campaign(people: int = 4) -> tuple[Campaign, Dataset]:
    """Three impacts a person; the shocks of the noise are `NOISE` of each peak."""
    conditions = [
        {"trial": "a", "mass_kg": 0.375, "velocity_m_s": 1.5},
        {"trial": "b", "mass_kg": 0.7, "velocity_m_s": 1.2},
        {"trial": "c", "mass_kg": 1.333, "velocity_m_s": 0.9},
    ]
    effects = dict.fromkeys(("sd_subject_K", "sd_subject_C"), 0.2)
    effects |= dict.fromkeys(("sd_impact_K", "sd_impact_C"), 0.05)
    recording = {
        "sampling_rate_hz": 5000.0,
        # Nothing beside what is added here.
        "noise_relative_to_peak": 1e-6,
        "offset_sd_m_s2": 0.2,
        "relative_gain_sd": 0.005,
        "velocity_sd_m_s": 0.005,
        "relative_mass_sd": 0.002,
    }
    made = simulate(
        Simulation.model_validate(
            {
                "name": "correlated",
                "seed": 5,
                "design": {"subjects": people, "conditions": conditions},
                "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0, **effects},
                "recording": recording,
            }
        )
    )
    data, random = made.dataset("x"), np.random.default_rng(8)

    def noisy(trace: Trace) -> Trace:
        settling = 200
        shocks = random.standard_normal(len(trace.value) + settling)
        noise = lfilter([1.0], [1.0, -RHO], shocks)[settling:]
        return Trace(trace.time_s, trace.value + NOISE * np.abs(trace.value).max() * noise)

    return made, replace(data, traces=[noisy(trace) for trace in data.traces])


def specification(**changes: object) -> ModelSpecification:
    found = read_specification(resources.shared("models", "impact.toml"))
    return found.model_copy(update={"noise": "autoregressive", **changes})


@pytest.mark.slow
def test_each_trace_alone_tells_its_tissue_and_its_noise_as_surely_as_it_says() -> None:
    made, data = campaign(people=40)
    given = prepare(data, specification(), source="the model file")
    assert given.model.nuisance == ("noise", "atanh_noise_correlation")
    start = first_guess(given)
    # A uniform contact moment leaves its likelihood flat on top.
    smooth = with_normal_errors(given.data)
    found = laplace_sites(given.model, smooth, jnp.asarray(start), weak_prior(start))
    count = len(start)
    sd = np.sqrt(np.diagonal(np.linalg.inv(np.asarray(found.precision)), axis1=1, axis2=2))
    truth = [
        np.log(made.truth["K_N_per_m"]),
        np.log(made.truth["C_N_s_per_m"]),
        np.full(count, np.log(NOISE)),
        np.full(count, np.arctanh(RHO)),
    ]
    # K and C are those at the recorded mass: its error of 0.2 % comes on top.
    sd = np.hypot(sd, [0.002, 0.002, 0.0, 0.0])
    z = (np.asarray(found.centre) - np.stack(truth, axis=1)) / sd
    # Squares of 120 standard normals: four standard errors of their mean.
    assert (np.abs(np.square(z).mean(0) - 1) < 4 * np.sqrt(2 / count)).all(), np.square(z).mean(0)


@pytest.mark.long
def test_a_fit_holds_the_correlation_and_finds_no_other_law() -> None:
    made, data = campaign()
    model = specification(sampler=Sampler(chains=2, warmup=300, draws=500))
    fit = fit_prepared(data, model, prepare(data, model, source="the model file"), 1, lambda *_: None)
    posterior = fit.posterior["posterior"].dataset
    low, high = np.tanh(posterior["atanh_noise_correlation_mean"].quantile([0.01, 0.99]).to_numpy())
    assert low < RHO < high
    # About 80 samples of each of twelve impacts tell it to 0.03.
    assert high - low < 0.2
    form = fit.diagnostics["model_form"]
    assert not form["structured"]
    # Of twelve impacts whose noise is the model's, correlated as it is.
    assert (form["impacts"]["tested"], form["impacts"]["structured"]) == (12, False)
    assert form["words"].startswith("Nothing against the model")
    true = {"K": made.truth["K_N_per_m"], "C": made.truth["C_N_s_per_m"]}
    true["noise_correlation"] = np.full(len(made.truth), RHO)
    for variable, values in true.items():
        low, high = posterior[variable].quantile([0.01, 0.99], ("chain", "draw")).to_numpy()
        # Of twelve 98 % intervals, dependent through the people: three misses are a thousandth's chance.
        assert ((low <= values) & (values <= high)).sum() >= 10, variable
