"""A fit: whole results, and the posterior that No-U-Turn gives of the model as it is written."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
from numpyro.infer import MCMC, NUTS
from scipy.stats import norm

import bayestissue as bt
from bayestissue.inference.samplers.sampling import effective_size
from bayestissue.recordings.dataset import Dataset
from campaigns import simulated, spreads

MODEL: dict[str, Any] = {
    "name": "m",
    "likelihood": "impact",
    "discrepancy": "none",
    "formula": {"K": "log(mass_kg) + (1|subject)", "C": "log(mass_kg) + (1|subject)"},
}
RECORDING = {
    "before_contact_s": 0.01,
    "noise_relative_to_peak": 0.005,
    "relative_mass_sd": 0.002,
    "velocity_sd_m_s": 0.005,
}


def campaign(people: int, masses: tuple[float, ...], rate: float = 2000.0, **errors: float) -> Dataset:
    """Clean impacts of some people with some masses."""
    tissue, recording = spreads(subject=0.2, impact=0.05), {"sampling_rate_hz": rate, **RECORDING, **errors}
    return simulated(tissue, recording, people=people, masses=masses, seed=5).dataset("small")


def fitted(dataset: Dataset, chains: int = 4, **model: Any) -> bt.Fit:
    return bt.fit(dataset, MODEL | model | {"sampler": {"chains": chains}}, seed=3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "errors"), [({}, {}), ({"discrepancy": "always"}, {}), ({}, {"relative_gain_sd": 0.01})]
)
def test_it_draws_from_the_posterior_that_trajectories_find(model, errors):
    """The referee: No-U-Turn on hyperparameters, effects and impacts, from gradients of the traces."""
    here = campaign(3, (0.5, 0.8, 1.2), **errors)
    kernel = NUTS(bt.numpyro_model(here, MODEL | model), target_accept_prob=0.95, dense_mass=False)
    chains = MCMC(kernel, num_warmup=1500, num_samples=2500, num_chains=2, chain_method="sequential")
    chains.run(jax.random.key(0))
    theirs, ours = chains.get_samples(group_by_chain=True), fitted(here, **model).posterior["posterior"]
    if "discrepancy" in theirs:
        # Theirs is sampled as a log.
        theirs["discrepancy"] = np.exp(theirs["discrepancy"])
    z = {}
    for name, values in theirs.items():
        if name not in ours:
            continue
        own = np.moveaxis(ours[name].to_numpy().reshape(*ours[name].shape[:2], -1), -1, 0)
        other = np.moveaxis(np.asarray(values).reshape(*values.shape[:2], -1), -1, 0)
        error = np.sqrt(sum(each.var((1, 2)) / effective_size(each) for each in (own, other)))
        for number, difference in enumerate((own.mean((1, 2)) - other.mean((1, 2))) / error):
            z[name, number] = difference
    assert len(z) > 30
    # Once in ten thousand such tests a difference this great is chance.
    assert np.nanmax(np.abs(list(z.values()))) < norm.isf(1e-4 / 2 / len(z)), z
