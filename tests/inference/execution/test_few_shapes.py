"""What is compiled for one dataset serves others of about its size, and filling up changes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.base.impact_arrays import padded_impacts
from bayestissue.inference.chain.target import Target
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.inference.factors.sites import POINTS, densities_at, log_likelihoods
from bayestissue.model.hierarchy import population
from bayestissue.model.hierarchy.gaussian import arrangement
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.recordings.dataset import Dataset
from campaigns import simulated, spreads
from dataset_bench import settings_of

# Sums of some ten thousand terms, in another order.
ROUNDING = 1e-10


def campaign(
    tmp_path, subjects: int, seed: int, mass_sd: float, masses: Sequence[float] = (0.4, 1.3)
) -> Dataset:
    recording = {"sampling_rate_hz": 2200.0, "noise_relative_to_peak": 0.005, "velocity_sd_m_s": 0.005}
    made = simulated(spreads(subject=0.1, impact=0.1), recording, people=subjects, masses=masses, seed=seed)
    chain = {"relative_mass_sd": mass_sd, "velocity_sd_m_s": 0.005}
    settings = settings_of(quantity="deceleration", contact="between", uncertainty=chain)
    return Dataset(settings, made.impacts, made.traces, folder=tmp_path)


@pytest.fixture(scope="module")
def specification() -> ModelSpecification:
    return ModelSpecification(name="impact", likelihood="impact")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Eighteen impacts on nine people: both are filled up."""
    return campaign(tmp_path_factory.mktemp("none"), 9, 1, 0.002)


def sites_of(prepared: Prepared) -> GaussianFactor:
    rng, centre = np.random.default_rng(2), first_guess(prepared)
    precision = np.broadcast_to(np.diag([400.0, 100.0, 50.0]), (*centre.shape, 3))
    return GaussianFactor(
        *map(jnp.asarray, (centre, rng.normal(size=centre.shape), precision, rng.normal(size=len(centre))))
    )


class Posterior(NamedTuple):
    """By the sites: the density of hyperparameters, b's conditional mean, and X b of every impact."""

    log_density: np.ndarray
    b: np.ndarray
    mean: np.ndarray


def posterior_of(made: Prepared, sites: GaussianFactor, y: np.ndarray) -> Posterior:
    target = Target.from_prepared(made)
    padded = GaussianFactor(*map(jnp.asarray, padded_impacts(sites)))

    @jax.jit
    def found(y: jax.Array) -> tuple[jax.Array, ...]:
        effects = target.given_sites(y, target.blocked(padded))
        b = target.effects_at(effects, jnp.zeros(made.model.locations.size))
        return effects.log_density, b, target.prior_mean(b)[:, : len(sites.centre)]

    return Posterior(*map(np.asarray, found(y)))


def test_a_model_is_its_value(dataset: Dataset, specification: ModelSpecification) -> None:
    one, other = (prepare(dataset, specification, source="model").model for _ in range(2))
    assert one is not other
    assert one == other
    assert hash(one) == hash(other)
    # The error of the mass is the dataset's, and a number that is traced.
    assert jax.tree.structure(one) == jax.tree.structure(replace(other, log_mass_sd=0.3))
    assert jax.tree.leaves(one) == [0.002]


@pytest.mark.slow
def test_filling_up_changes_neither_densities_nor_conditionals(dataset, specification, monkeypatch) -> None:
    prepared = prepare(dataset, specification, source="model")
    with monkeypatch.context() as patch:
        for module in (population, arrangement):
            patch.setattr(module, "bucket", lambda count: count)
        plain = prepare(dataset, specification, source="model")
    model, data, sites = prepared.model, prepared.data, sites_of(prepared)
    assert plain.model.locations.size < model.locations.size
    y = np.random.default_rng(3).normal(size=len(model.hyperparameters)) - 1
    filled, whole = (posterior_of(made, sites, y) for made in (prepared, plain))
    assert_allclose(filled.log_density, whole.log_density, rtol=ROUNDING)
    assert_allclose(filled.mean, whole.mean, rtol=ROUNDING)
    for name, part in plain.model.locations.parts.items():
        b, count = filled.b[model.locations.parts[name]], part.stop - part.start
        assert_allclose(b[:count], whole.b[part], rtol=ROUNDING, atol=ROUNDING)
        # A person who is not there has the prior's mean.
        assert_allclose(b[count:], 0.0, atol=ROUNDING)
    u = np.asarray(sites.centre) + 0.1 * np.random.default_rng(4).normal(size=(POINTS, *sites.centre.shape))
    found = log_likelihoods(model, data, u)
    assert found.shape == u.shape[:2]
    assert_allclose(found, densities_at.jitted(model, data, u, POINTS), rtol=ROUNDING)
