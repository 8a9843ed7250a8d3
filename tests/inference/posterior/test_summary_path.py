"""Both paths lead to the same posterior."""

from __future__ import annotations

import pickle
import tomllib
from collections.abc import Iterator
from typing import Any

import cloudpickle
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arviz_stats.base import array_stats
from scipy.special import logsumexp

from bayestissue.dataset.chain import Uncertainty
from bayestissue.dataset.model import Dataset, Trace
from bayestissue.hierarchy.specification import ModelSpecification, Sampler
from bayestissue.hierarchy.trace_data import Prepared, prepare
from bayestissue.hierarchy.traces import gaussian
from bayestissue.inference.execution import chunks
from bayestissue.inference.factors.conditional import (
    ConditionalPrior,
    PopulationDraws,
    normals,
    of_cells,
    population_draws,
    standard_points,
)
from bayestissue.inference.factors.grid import PLACES, LikelihoodGrid
from bayestissue.inference.factors.importance_ratios import (
    importance_ratios,
    log_evidence_corrections,
)
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.posterior import approximate as approximation_module
from bayestissue.inference.posterior import recipe
from bayestissue.inference.factors.expansions import Approximation, approximate
from bayestissue.inference.posterior.constrained_draws import constrained_draws
from bayestissue.inference.posterior.correction import Correction
from bayestissue.inference.posterior.exact import exact_draws
from bayestissue.inference.posterior.recipe import (
    Problem,
    corrected_draws,
    fitted_to_population,
    population_attempt,
)
from bayestissue.inference.posterior.refinement import draws_at, refitted, to_second_order
from bayestissue.inference.samplers.psis import pareto_smoothed
from bayestissue.inference.samplers.sampling import Draws
from bayestissue.simulation import simulate
from bayestissue.simulation.specification import Simulation
from campaigns import FOUR_BY_FOUR


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    campaign = simulate(Simulation.model_validate(tomllib.loads(FOUR_BY_FOUR)))
    ends = np.cumsum(campaign.n_samples)
    traces = [
        Trace(campaign.time[end - n : end], campaign.value[end - n : end].astype(float))
        for n, end in zip(campaign.n_samples, ends, strict=True)
    ]
    return Dataset(
        name="four by four",
        description="",
        impacts=campaign.impacts,
        traces=traces,
        quantity="deceleration",
        uncertainty=Uncertainty(relative_mass_sd=0.002, velocity_sd_m_s=0.005),
        warnings=(),
        left_out=(),
        folder=tmp_path_factory.mktemp("none"),
        input_hash="",
    )


@pytest.fixture(scope="module")
def prepared(dataset: Dataset) -> Prepared:
    return prepare(dataset, ModelSpecification(name="a2", likelihood="a2"), source="model")


def test_points_have_the_moments_of_a_standard_normal_to_their_number() -> None:
    points = standard_points(3, 256)
    # Mirror images: odd moments vanish; even ones err by far less than independent points' sqrt(2 / 256).
    np.testing.assert_allclose(points.mean(0), 0, atol=1e-12)
    np.testing.assert_allclose(np.cov(points.T), np.eye(3), atol=np.sqrt(2 / 256))


def test_a_profile_interpolates_cubics_and_integrates_against_a_normal() -> None:
    # exp(a x - x^2 / 2) against N(m, s^2) is a normal integral in closed form.
    slope = np.array([0.3, -1.0])
    profile = LikelihoodGrid(jnp.asarray(slope * PLACES[:, None] - PLACES[:, None] ** 2 / 2))
    at = np.array([0.123, -2.345])
    # A quadratic is its own cubic interpolant, to rounding.
    np.testing.assert_allclose(jax.jit(LikelihoodGrid.at)(profile, at), slope * at - at**2 / 2, rtol=1e-10)
    mean, sd = 0.4, 0.7
    variance = 1 / (1 + 1 / sd**2)
    middle = variance * (slope + mean / sd**2)
    exact = np.log(np.sqrt(variance) / sd) + (middle**2 / variance - mean**2 / sd**2) / 2
    found = jax.jit(LikelihoodGrid.log_evidence)(profile, mean, sd)
    # 32 points integrate this to far better than single precision.
    np.testing.assert_allclose(found, exact, rtol=1e-7)


SETTINGS = Sampler(chains=2, warmup=200, draws=500)


@pytest.fixture(scope="module")
def summary_route(prepared: Prepared) -> tuple[Approximation, Draws, Correction]:
    return corrected_draws(prepared, SETTINGS, 1)


def test_a_draw_beyond_what_numbers_hold_is_never_chosen_and_spoils_no_other(
    prepared: Prepared, summary_route: tuple[Approximation, Draws, Correction], monkeypatch
) -> None:
    """One made every impact's importance ratios NaN, and the sites fitted about them ended the fit."""
    approximation = summary_route[0]

    def overflowing(*arguments: Any) -> tuple[PopulationDraws, np.ndarray]:
        population, z_b = draws_at(*arguments)
        return population._replace(b=np.where(np.arange(len(z_b))[:, None] == 0, np.nan, population.b)), z_b

    problem = Problem(prepared, SETTINGS, 1, np.random.default_rng(1))
    plain = population_attempt(problem, approximation).correction
    monkeypatch.setattr(recipe, "draws_at", overflowing)
    attempt = population_attempt(problem, approximation)
    assert np.isfinite(attempt.draws.b).all()
    assert attempt.correction.trusted == plain.trusted
    # It was one of a thousand.
    assert attempt.correction.effective == pytest.approx(plain.effective, rel=0.02)


def test_summaries_stand_for_the_traces(
    prepared: Prepared, summary_route: tuple[Approximation, Draws, Correction]
) -> None:
    sites, draws, correction = summary_route
    assert correction.trusted
    assert correction.relative > 0.5
    constrained = constrained_draws(prepared, sites, draws, jax.random.PRNGKey(1))
    assert constrained.impacts["K"].shape == (2, 500, 16)
    assert np.isfinite(constrained.log_likelihood["trace"]).all()


def test_what_other_processes_make_of_each_impact_is_the_same(
    prepared: Prepared,
    summary_route: tuple[Approximation, Draws, Correction],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A step's function is sent to them by value, and what it calls by name."""
    sent = []

    def elsewhere(function: Any, items: Any, **_: Any) -> Iterator[tuple[int, Any]]:
        for place, item in enumerate(items):
            sent.append(cloudpickle.dumps(item))
            yield place, function(pickle.loads(sent[-1]))  # noqa: S301 - our own

    def values_of(approximation: Approximation, draws: Draws) -> list[np.ndarray]:
        constrained = constrained_draws(prepared, approximation, draws, jax.random.PRNGKey(1))
        return [*draws.sites.values(), *constrained.impacts.values()]

    here = values_of(*summary_route[:2])
    monkeypatch.setattr(chunks, "cluster", lambda: "elsewhere")
    monkeypatch.setattr(chunks, "computed", elsewhere)
    approximation, draws, _ = corrected_draws(prepared, SETTINGS, 1)
    for own, other in zip(here, values_of(approximation, draws), strict=True):
        np.testing.assert_array_equal(own, other)
    assert len(sent) > 3


@pytest.mark.long
def test_a_grid_without_numbers_gives_way_to_normals(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a wall's is on creeping tissue, where the sites that it was made about were none."""
    arma = prepare(dataset, ModelSpecification(name="arma", likelihood="arma"), source="model")
    nothing = LikelihoodGrid(jnp.full((len(PLACES), len(arma.impacts)), jnp.nan))
    monkeypatch.setattr(approximation_module, "_grid", lambda *_, **__: nothing)
    found = approximate(arma, normal=False)
    assert found.grid is None
    assert np.isfinite(found.coordinates.covariance).all()


def test_sites_whose_marginal_has_no_mode_are_not_taken(
    prepared: Prepared,
    summary_route: tuple[Approximation, Draws, Correction],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nowhere(*_: object) -> Approximation:
        raise FloatingPointError("nowhere")

    approximation = summary_route[0]
    draws = to_second_order(prepared, approximation, 64, np.random.default_rng(5))
    monkeypatch.setattr(Approximation, "near", nowhere)
    assert refitted(prepared, approximation, draws, 5) is approximation


def test_corrections_are_what_many_points_of_each_population_say(dataset: Dataset) -> None:
    """Where contact lies anywhere between two samples, no trace's likelihood is normal."""
    prepared = prepare(dataset, ModelSpecification(name="impact", likelihood="impact"), source="model")
    assert np.asarray(prepared.data.record.contact.uniform).all()
    rng = np.random.default_rng(3)
    approximation = fitted_to_population(Problem(prepared, SETTINGS, 3, rng), approximate(prepared))
    model, data, summaries = prepared.model, prepared.data, approximation.sites
    # Populations as the posterior has them, one with hardly any spread of the noise among them.
    size = len(approximation.coordinates.names)
    raw = approximation.coordinates.raw(
        rng.multivariate_normal(np.zeros(size), approximation.coordinates.covariance, 64)
    )
    raw["sd_noise"][:2] = -7.0
    z_b = np.zeros((64, model.locations.size))
    drawn = population_draws(model, gaussian(data, summaries), raw, z_b)
    anchors = of_cells(drawn.priors(data.design), np.asarray(data.design.cell))
    ratios = importance_ratios(model, data, summaries, anchors, standard_points(3))
    first = ConditionalPrior(*(part[:8] for part in anchors))
    tabulated = log_evidence_corrections(summaries, ratios, first)
    u = normals(summaries, first).at(standard_points(3, 2048)[:, None, None])
    flat = u.reshape(-1, *u.shape[2:])
    ratio = (log_likelihoods(model, data, flat) - summaries.log_density(flat)).reshape(u.shape[:3])
    direct = logsumexp(ratio, axis=0) - np.log(len(ratio))
    error = tabulated - direct
    # The scatter of 64 points, most of which all populations share.
    assert np.abs(error).max() < 5 * ratio.std(0).max() / np.sqrt(64)
    # Log weights matter by their differences between populations: what is left must not move a sum over
    # impacts by its own scatter.
    error = error - error.mean(0)
    assert np.abs(error.sum(1)).max() < 0.25
    assert np.abs(error).max() < 0.15


def test_smoothed_weights_lead_from_draws_to_their_target() -> None:
    draws = np.random.default_rng(5).normal(size=4000)
    # From N(0, 1) to N(0.5, 1): weights exp(x / 2), whose effective number is exp(-1 / 4) of all.
    smoothed, k = pareto_smoothed(0.5 * draws)
    weight = np.exp(smoothed - smoothed.max())
    mean = (weight * draws).sum() / weight.sum()
    assert k < 0.4
    # Five standard errors.
    assert abs(mean - 0.5) < 5 / np.sqrt(4000 * np.exp(-0.25))


def quantities(prepared: Prepared, sites: Approximation, draws: Draws) -> np.ndarray:
    """The hyperparameters, the effects, and log K and log C of every impact, [chain, draw, quantity]."""
    flat = {name: values.reshape(-1, *values.shape[2:]) for name, values in draws.sites.items()}
    z_b, z_u = flat.pop("standard_locations"), flat.pop("standard_impacts")
    every = population_draws(prepared.model, sites.data(prepared.data), flat, z_b)
    design = prepared.data.design
    u = normals(sites.sites, of_cells(every.priors(design), np.asarray(design.cell))).at(z_u)
    columns = [np.stack([flat[name] for name in prepared.model.hyperparameters], axis=1), every.b]
    columns += [u[..., :2].reshape(len(u), -1)]
    return np.concatenate(columns, axis=1).reshape(SETTINGS.chains, SETTINGS.draws, -1)


def test_the_summary_and_the_exact_route_agree_within_their_monte_carlo_errors(
    prepared: Prepared, summary_route: tuple[Approximation, Draws, Correction]
) -> None:
    sites = approximate(prepared)
    found = [
        quantities(prepared, *summary_route[:2]),
        quantities(prepared, sites, exact_draws(prepared, sites, SETTINGS, 2, processes=False)),
    ]
    distance = []
    for one, other in zip(*(np.moveaxis(each, -1, 0) for each in found), strict=True):
        error = np.hypot(*(float(array_stats.mcse(each, method="mean")) for each in (one, other)))
        distance.append((one.mean() - other.mean()) / error)
    # Some sixty numbers: the greatest of as many standard normals is beyond 4.5 in one run of two thousand.
    assert len(distance) > 32
    assert np.abs(distance).max() < 4.5
