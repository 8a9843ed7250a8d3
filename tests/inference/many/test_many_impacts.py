"""Fits of many impacts: shared out in blocks, kept in part, and the posterior that every path has."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from arviz_stats.base import array_stats
from numpyro.distributions import biject_to

from bayestissue.inference import fit as traces
from bayestissue.inference.chain import chain_settings, draws
from bayestissue.inference.chain.moves import StudentT, Tuning
from bayestissue.inference.execution import chunks as trace_blocks
from bayestissue.inference.execution import kept as many_kept
from bayestissue.inference.execution.chunks import map_impacts
from bayestissue.inference.execution.kept import kept_draws, some_impacts
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.inference.factors.sites import log_likelihoods
from bayestissue.inference.quantities.quantity_draws import posterior_draws
from bayestissue.inference.results.summary import summarise
from bayestissue.model.hierarchy.gaussian.arrangement import arrange
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.model.hierarchy.trace_data import prepare
from bayestissue.model.hierarchy.trace_models import TraceData
from bayestissue.model.likelihood.displacements import displacement_record
from bayestissue.recordings.dataset.model import Dataset
from campaigns import binomial, simulated
from chain_of_sites import chain_of_sites

COUNT = 21


def data_of_sines() -> TraceData:
    time = np.arange(30) * 1e-3
    x = np.sin(40 * time) * np.arange(1, COUNT + 1)[:, None] * 1e-3
    same = np.ones(COUNT)
    record = displacement_record(x, np.full(COUNT, 30), 0 * same, 1e-3 * same, np.zeros((COUNT, 3)))
    design = arrange([np.ones((3, 2))], np.arange(COUNT) % 3, [])
    return TraceData(record, design, jnp.zeros(2), jnp.arange(COUNT) * 1.0, jnp.zeros(COUNT))


def sums(part: TraceData, rows: np.ndarray) -> dict[str, Any]:
    spectrum = sum(jnp.asarray(column).sum((0, 2)) for column in part.record.columns)
    return {"x": jnp.asarray(part.record.x).sum(1), "spectrum": spectrum, "rows": rows, "mass": part.log_mass}


@pytest.mark.slow
@pytest.mark.parametrize("few", [1, 100], ids=["in processes", "in this process"])
def test_blocks_end_to_end_are_the_whole(monkeypatch: pytest.MonkeyPatch, few: int) -> None:
    monkeypatch.setattr(trace_blocks, "BLOCK", 4)
    monkeypatch.setattr(trace_blocks, "_FEW", few)
    data, told = data_of_sines(), []
    found = map_impacts(sums, data, np.arange(COUNT), progress=lambda done, total: told.append((done, total)))
    whole = sums(data, np.arange(COUNT))
    for name, values in whole.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-13, atol=1e-15)
    assert told[-1] == (6, 6)


def test_a_block_is_copied_when_its_turn_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them at once would be the traces a second time."""
    monkeypatch.setattr(trace_blocks, "BLOCK", 4)
    impacts, done = TraceData.impacts, []
    monkeypatch.setattr(TraceData, "impacts", lambda data, rows: done.append("copied") or impacts(data, rows))
    trace_blocks.map_impacts(lambda part: done.append("computed") or part.log_mass, data_of_sines())
    assert done == ["copied", "computed"] * 6


def test_draws_and_impacts_that_are_kept_are_evenly_spaced_and_no_more_than_allowed() -> None:
    assert list(kept_draws(4, 1000, 1000)) == list(range(1000))
    assert 4 * len(kept_draws(4, 1000, 1001)) == many_kept.IMPACT_DRAWS
    kept = kept_draws(4, 1000, 100_000)
    assert 4 * len(kept) * 100_000 <= many_kept.MOST_PAIRS
    assert len(set(np.diff(kept))) == 1
    assert list(some_impacts(7)) == list(range(7))
    shown = some_impacts(100_000)
    assert (len(shown), shown[0], shown[-1]) == (many_kept.FEW, 0, 99_999)


def test_intervals_of_few_kept_draws_hold_what_they_promise() -> None:
    rng = np.random.default_rng(5)
    impacts, kept = 4000, 50
    draws = rng.normal(size=(2, kept, impacts))
    posterior = xr.Dataset(
        {
            "K": (("chain", "kept_draw", "impact"), draws),
            "sd": (("chain", "draw"), rng.normal(size=(2, 400))),
            "mass_exponent_K_secant": (("chain", "kept_draw"), draws[..., 0]),
        },
        {"impact": np.arange(impacts).astype(str)},
    )
    table = summarise(posterior)
    of_impacts = table[table["variable"] == "K"]
    new = rng.normal(size=impacts)
    held = ((of_impacts["eti90_low"] < new) & (new < of_impacts["eti90_high"])).mean()
    assert abs(held - 0.9) < binomial(impacts)
    assert of_impacts["r_hat"].isna().all()
    of_population = table[table["variable"] == "mass_exponent_K_secant"]
    assert list(of_population["label"]) == [""]
    assert float(of_population["median"].iloc[0]) == float(of_impacts["median"].iloc[0])
    assert table.loc[table["variable"] == "sd", "r_hat"].notna().all()


@pytest.fixture(scope="module")
def dozen() -> Dataset:
    """Three people in two conditions, twice each."""
    recording = {"sampling_rate_hz": 1000.0, "noise_relative_to_peak": 0.005}
    tissue, design = {"sd_subject_K": 0.2}, {"repeats": 2}
    made = simulated(tissue, recording, people=3, masses=(0.5, 1.0), design=design, seed=6)
    return made.dataset("dozen")


@pytest.mark.slow
def test_impacts_drawn_few_at_a_time_share_their_persons_error_of_mass(dozen, monkeypatch) -> None:
    specification = ModelSpecification.model_validate(
        {"name": "shared", "likelihood": "impact", "mass_error": "subject"}
    )
    dozen = dozen.with_settings(uncertainty=dozen.uncertainty.model_copy(update={"relative_mass_sd": 0.05}))
    made = prepare(dozen, specification, source="model")
    model, centre = made.model, first_guess(made)
    number, size = centre.shape
    narrow = np.broadcast_to(1e6 * np.eye(size), (number, size, size))
    sites = GaussianFactor(centre, np.zeros(centre.shape), narrow, np.zeros(number))
    rng = np.random.default_rng(2)
    chains = chain_of_sites(made, sites, rng.normal(-1, 0.1, (2, 40, len(model.hyperparameters))), rng)
    seen = chains.population.b.reshape(80, -1)
    monkeypatch.setattr(trace_blocks, "BLOCK", 5)
    monkeypatch.setattr(many_kept, "FEW", 11)
    monkeypatch.setattr(many_kept, "MOST_PAIRS", 1)
    found = posterior_draws(made, chains, 1)
    assert list(found.kept_numbers) == list(range(0, 40, 4))
    error = (np.log(found.impacts["mass"]) - np.asarray(made.data.log_mass)).reshape(20, -1)
    own = error[:, [np.flatnonzero(made.design.subject == s)[0] for s in range(3)]]
    # In 32 bits, of a log near 0.
    np.testing.assert_allclose(error, own[:, made.design.subject], atol=1e-6)
    assert np.abs(own).min() > 1e-5
    # They are those of b.
    of_people = seen[:, model.locations.parts["log_mass_error"]].reshape(2, 40, -1)[:, found.kept_numbers]
    np.testing.assert_allclose(of_people[..., :3].reshape(20, 3), own, atol=1e-6)
    # GaussianFactor so narrow leave the parameters where they are: in blocks each impact has its own.
    np.testing.assert_allclose(found.impacts["parameters"][0, 0], centre, atol=0.01)


@pytest.mark.long
def test_of_many_impacts_some_begin_and_some_draws_are_kept(dozen, monkeypatch) -> None:
    """As of thousands: the population from six of the twelve, and every tenth draw of each."""
    monkeypatch.setattr(chain_settings, "TOGETHER", 5)
    monkeypatch.setattr(many_kept, "FEW", 11)
    monkeypatch.setattr(draws, "FIRST", 6)
    made = prepare(dozen, ModelSpecification(name="impact", likelihood="impact"), source="model")
    chains = traces.sample(made, Sampler(chains=2, transitions=100), 1)
    number = chains.shape[1]
    np.testing.assert_array_equal(chains.impact_draws, np.arange(9, number, 10))
    assert chains.u.shape[:3] == (2, number // 10, 12)
    assert chains.u.dtype == np.float32
    assert chains.log_ratios["impact"].shape == (2, number, 11)
    # What is kept of the ratios is that of the draws that are kept of impacts.
    density = np.asarray(chains.sites.log_density(chains.u.astype(float)))
    model, data = made.model, made.data
    value = log_likelihoods(model, data, chains.u.reshape(-1, *chains.u.shape[2:]).astype(float))
    ratio = value.reshape(density.shape) - density
    # Seven digits of u, over slopes of some hundred.
    kept = chains.log_ratios["impact"][:, chains.impact_draws]
    np.testing.assert_allclose(ratio[..., many_kept.some_impacts(12)], kept, atol=1e-2)
    found = posterior_draws(made, chains, 1)
    np.testing.assert_array_equal(found.kept_numbers, chains.impact_draws)
    assert all(np.isfinite(values).all() for values in found.log_likelihood.values())


@pytest.mark.slow
def test_of_many_impacts_an_error_of_the_gain_of_all_moves(monkeypatch) -> None:
    """Its mean over impacts is known far better than any impact's own: no step of theirs alone moves it."""
    recording = {"sampling_rate_hz": 5000.0, "noise_relative_to_peak": 0.003, "relative_gain_sd": 0.02}
    campaign = simulated({}, recording, people=3, masses=(0.5, 1.0), design={"repeats": 10}, seed=6)
    made = prepare(
        campaign.dataset("gain"), ModelSpecification(name="impact", likelihood="impact"), source="model"
    )
    monkeypatch.setattr(chain_settings, "TOGETHER", 5)
    monkeypatch.setattr(many_kept, "FEW", 11)
    monkeypatch.setattr(draws, "FIRST", 30)
    chains = traces.sample(made, Sampler(chains=2, transitions=1000), 2)
    gain = chains.population.b[..., made.model.locations.parts["log_gain_mean"]][..., 0]
    # By steps of impacts alone and a spread that is sampled there were ten.
    assert array_stats.ess(np.asarray(gain)) > 100


@pytest.mark.parametrize(("of_difference", "segment"), [(0.4, 20), (0.6, 50)])
def test_of_clear_traces_the_population_moves_with_them_fixed(
    dozen, monkeypatch, of_difference, segment
) -> None:
    """Clear are traces that tell K and C to half of what impacts differ by."""
    monkeypatch.setattr(many_kept, "FEW", 11)
    made = prepare(dozen, ModelSpecification(name="impact", likelihood="impact"), source="model")
    names, size = made.model.hyperparameters, 2 + len(made.model.nuisance)
    spreads = [(biject_to(made.model.prior_of(name).support), name) for name in names]
    location = [float(to.inv(0.1)) if name.startswith("sd_impact") else 0.0 for to, name in spreads]
    precision = np.broadcast_to(np.eye(size) / (of_difference * 0.1) ** 2, (1, 12, size, size))
    nothing = np.zeros((1, 12, size))
    sites = GaussianFactor(nothing, nothing, precision, np.zeros((1, 12)))
    tuning = Tuning(sites, StudentT(np.array(location), np.eye(len(names))), None, None, None, None)
    assert draws._settings(made, tuning).segment == segment
