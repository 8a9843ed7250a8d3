"""What is compiled for one dataset serves others of about its size, and filling up changes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpyro.infer.util import potential_energy

from bayestissue.dataset.chain import Uncertainty
from bayestissue.dataset.model import Dataset, Trace
from bayestissue.hierarchy import population
from bayestissue.hierarchy.gaussian import arrangement
from bayestissue.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.hierarchy.trace_data import Prepared, prepare
from bayestissue.hierarchy.traces import COORDINATES, gaussian, sampled_model
from bayestissue.inference.execution.compiling import compiled_quickly
from bayestissue.inference.factors.conditional import (
    DRAWS,
    PopulationDraws,
    population_draw,
    population_draws,
)
from bayestissue.inference.factors.likelihoods import POINTS, densities_at, log_likelihoods
from bayestissue.inference.factors.expansions import _value_and_slope, first_guess
from bayestissue.inference.posterior.constrained_draws import constrained_draws, constrained_impacts
from bayestissue.inference.posterior.recipe import corrected_draws
from bayestissue.inference.samplers import independence
from bayestissue.inference.samplers.coordinates import unwarped
from bayestissue.padding import padded_zeros
from bayestissue.simulation import simulate
from bayestissue.simulation.specification import Simulation

# Sums of some ten thousand terms, in another order.
ROUNDING = 1e-10


def campaign(
    tmp_path, subjects: int, seed: int, mass_sd: float, masses: Sequence[float] = (0.4, 1.3)
) -> Dataset:
    conditions = [{"trial": f"m{mass}", "mass_kg": mass, "velocity_m_s": 1.5} for mass in masses]
    tissue = {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0}
    tissue |= {f"sd_{each}": 0.1 for each in ("subject_K", "impact_K", "subject_C", "impact_C")}
    recording = {"sampling_rate_hz": 2200.0, "noise_relative_to_peak": 0.005, "velocity_sd_m_s": 0.005}
    content = {
        "name": "few",
        "seed": seed,
        "design": {"subjects": subjects, "conditions": conditions},
        "tissue": tissue,
        "recording": recording,
    }
    made = simulate(Simulation.model_validate(content))
    ends = np.cumsum(made.n_samples)
    return Dataset(
        name="few",
        description="",
        impacts=made.impacts,
        traces=[
            Trace(made.time[end - n : end], made.value[end - n : end].astype(float))
            for n, end in zip(made.n_samples, ends, strict=True)
        ],
        quantity="deceleration",
        uncertainty=Uncertainty(relative_mass_sd=mass_sd, velocity_sd_m_s=0.005),
        warnings=(),
        left_out=(),
        folder=tmp_path,
        input_hash="",
    )


@pytest.fixture(scope="module")
def specification() -> ModelSpecification:
    return ModelSpecification(
        name="impact", likelihood="impact", sampler=Sampler(chains=2, warmup=100, draws=100)
    )


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


def test_a_model_is_its_value(dataset: Dataset, specification: ModelSpecification) -> None:
    one, other = (prepare(dataset, specification, source="model").model for _ in range(2))
    assert one is not other
    assert one == other
    assert hash(one) == hash(other)
    # The error of the mass is the dataset's, and a number that is traced.
    assert jax.tree.structure(one) == jax.tree.structure(replace(other, log_mass_sd=0.3))
    assert jax.tree.leaves(one) == [0.002]


def test_fewer_people_and_impacts_left_out_have_the_same_shapes(
    specification: ModelSpecification, tmp_path
) -> None:
    """People and conditions are crossed, and both are filled up."""
    masses = np.round(np.geomspace(0.4, 1.3, 9), 3).tolist()
    whole = campaign(tmp_path, 10, 1, 0.002, masses)
    keep = np.sort(np.random.default_rng(1).permutation(90)[:86])
    left = whole.impacts.iloc[keep].reset_index(drop=True)
    part = replace(whole, impacts=left, traces=[whole.traces[i] for i in keep])
    shapes = set()
    for each in (whole, campaign(tmp_path, 9, 2, 0.002, masses), part):
        prepared = prepare(each, specification, source="model")
        data = prepared.data.padded
        sizes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(data))
        shapes.add((jax.tree.structure((prepared.model, data)), sizes))
    assert len(shapes) == 1


def test_filling_up_changes_neither_densities_nor_slopes_nor_conditionals(
    dataset: Dataset, specification: ModelSpecification, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared = prepare(dataset, specification, source="model")
    with monkeypatch.context() as patch:
        for module in (population, arrangement):
            patch.setattr(module, "bucket", lambda count: count)
        plain = prepare(dataset, specification, source="model")
    model, data, sites = prepared.model, prepared.data, sites_of(prepared)
    assert plain.model.locations.size < model.locations.size
    own, other = gaussian(data, sites), gaussian(plain.data, sites)
    y = np.random.default_rng(3).normal(size=len(model.hyperparameters)) - 1
    warp = unwarped(len(y))
    found = _value_and_slope(model, y, own, None, warp)
    wanted = _value_and_slope(plain.model, y, other, None, warp)
    for values in zip(found, wanted, strict=True):
        assert_allclose(*values, rtol=ROUNDING)
    raw = {name: np.full(DRAWS, value) for name, value in zip(model.hyperparameters, y, strict=True)}
    found = population_draws(model, own, raw, np.zeros((DRAWS, model.locations.size)))
    at_mean = np.zeros((DRAWS, plain.model.locations.size))
    wanted = PopulationDraws(raw, *population_draw.jitted(plain.model, other, raw, at_mean, DRAWS))
    pairs = (found, prepared.data.design), (wanted, plain.data.design)
    about, of_plain = (each.priors(design).mean[:, np.asarray(design.cell)] for each, design in pairs)
    assert about.shape == (DRAWS, *sites.centre.shape)
    assert_allclose(about, of_plain, rtol=ROUNDING)
    assert_allclose(found.precision, wanted.precision, rtol=ROUNDING)
    for name, part in plain.model.locations.parts.items():
        b, count = found.b[:, model.locations.parts[name]], part.stop - part.start
        assert_allclose(b[:, :count], wanted.b[:, part], rtol=ROUNDING, atol=ROUNDING)
        # A person who is not there has the prior's mean.
        assert_allclose(b[:, count:], 0.0, atol=ROUNDING)
    u = np.asarray(sites.centre) + 0.1 * np.random.default_rng(4).normal(size=(POINTS, *sites.centre.shape))
    found = log_likelihoods(model, data, u)
    assert found.shape == u.shape[:2]
    assert_allclose(found, densities_at.jitted(model, data, u, POINTS), rtol=ROUNDING)


def test_the_exact_path_leaves_out_what_was_added(
    dataset: Dataset, specification: ModelSpecification
) -> None:
    prepared = prepare(dataset, specification, source="model")
    model, data, sites = prepared.model, prepared.data, sites_of(prepared)
    number, size = sites.centre.shape
    more = data.padded, padded_zeros(sites)
    present = np.arange(len(more[1].centre)) < number
    rng = np.random.default_rng(5)
    z_u = np.zeros((len(present), size))
    z_u[:number] = rng.normal(size=(number, size))
    # Where nobody is, standard normals may be anything.
    z_u[number:] = 30.0
    point = {
        COORDINATES: rng.normal(size=len(model.hyperparameters)) - 1,
        "standard_locations": rng.normal(size=model.locations.size),
    }
    warp = unwarped(len(model.hyperparameters))

    def potential(arguments, z_u):
        return potential_energy(sampled_model, arguments, {}, point | {"standard_impacts": z_u})

    slopes = compiled_quickly(jax.value_and_grad(potential, argnums=1))
    value, slope = slopes((model, *more, warp, present), z_u)
    wanted, of_those = slopes((model, data, sites, warp), z_u[:number])
    assert_allclose(value - np.sum(z_u[number:] ** 2 / 2 + np.log(2 * np.pi) / 2), wanted, rtol=ROUNDING)
    assert_allclose(slope[:number], of_those, rtol=1e-7, atol=1e-7)
    assert_allclose(slope[number:], z_u[number:])


@pytest.mark.long
def test_another_dataset_of_about_that_size_compiles_nothing(
    dataset: Dataset, specification: ModelSpecification, tmp_path
) -> None:
    """Fewer people, other lengths, another error of the mass: the functions of a fit are compiled once."""

    def fitted(dataset: Dataset) -> None:
        prepared = prepare(dataset, specification, source="model")
        approximation, draws, _ = corrected_draws(prepared, specification.sampler, 1)
        found = constrained_draws(prepared, approximation, draws, jax.random.PRNGKey(0))
        impacts, people = len(prepared.impacts), len(prepared.design.subjects)
        assert draws.sites["standard_impacts"].shape[2] == impacts
        assert {each.shape[2] for each in found.impacts.values()} == {impacts}
        assert found.sites["subject_effect_K"].shape[2] == people

    functions = [densities_at, population_draw, constrained_impacts, independence.log_densities]
    compiled = [*(function.jitted for function in functions), _value_and_slope]
    fitted(dataset)
    sizes = [function._cache_size() for function in compiled]
    fitted(campaign(tmp_path, 10, 2, 0.004))
    assert [function._cache_size() for function in compiled] == sizes
