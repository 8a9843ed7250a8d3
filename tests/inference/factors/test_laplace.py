"""Laplace sites of traces' likelihoods, against derivatives and closed forms."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayestissue.inference.factors.conditional import ConditionalPrior, log_evidence, normals
from bayestissue.inference.factors.expansions import first_guess
from bayestissue.inference.factors.sites import (
    curvature_floor,
    laplace_sites,
    weak_prior,
)
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.specification import ModelSpecification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.model.hierarchy.trace_models import log_likelihood, with_normal_errors
from campaigns import simulated


@cache
def prepared(kind: str) -> Prepared:
    recording = {"sampling_rate_hz": 2000.0, "noise_relative_to_peak": 0.005}
    made = simulated({}, recording, people=2, masses=(0.4, 0.9, 1.3), seed=4)
    specification = ModelSpecification.model_validate({"name": kind, "likelihood": kind})
    return prepare(made.dataset("six"), specification, source="model")


def summaries_of(size: int, impacts: int = 5) -> tuple[GaussianFactor, ConditionalPrior]:
    rng = np.random.default_rng(7)
    root = rng.standard_normal((impacts + 1, size, size))
    precision = root @ root.swapaxes(1, 2) + np.eye(size)
    centre, slope = rng.standard_normal((2, impacts, size))
    parts = (centre, slope, precision[1:], rng.standard_normal(impacts))
    return GaussianFactor(*map(jnp.asarray, parts)), ConditionalPrior(
        rng.standard_normal((impacts, size)), precision[0]
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", [pytest.param("arma", marks=pytest.mark.long), "impact"])
def test_an_expansion_has_the_derivatives_of_the_likelihood(kind: str) -> None:
    given = prepared(kind)
    data = with_normal_errors(given.data)
    start = first_guess(given)
    found = laplace_sites(given.model, data, start, weak_prior(start))

    def value(u: jax.Array) -> jax.Array:
        return log_likelihood(given.model, data, list(u.T)).sum()

    @jax.jit
    def derivatives(u: jax.Array) -> tuple[jax.Array, jax.Array]:
        along = jnp.broadcast_to(jnp.eye(u.shape[1])[:, None], (u.shape[1], *u.shape))
        columns = jax.vmap(lambda each: jax.jvp(jax.grad(value), (u,), (each,))[1])(along)
        return jax.grad(value)(u), -jnp.moveaxis(columns, 0, -1)

    slope, bend = derivatives(found.centre)
    sd = 1 / np.sqrt(np.diagonal(np.asarray(bend), axis1=1, axis2=2))
    # Each parameter's likelihood changes over a fortieth of a unit or more: a third derivative is up to forty
    # times the second, or the first where that saturates. Values are rounded in the twelfth digit.
    step = np.minimum(0.03 * sd, 0.003)
    off = 40 * step**2 / 6 * (1 / sd + np.abs(np.asarray(slope)) * sd) + 1e-9
    assert (np.abs(np.asarray(found.shift - slope)) * sd < off).all()
    scaled = np.asarray(found.precision - bend) * sd[:, :, None] * sd[:, None]
    assert np.abs(scaled).max() < 40**2 * step.max() ** 2 / 12 + 1e-6
    # Where the search ended no step promises more than a millionth.
    anchor = weak_prior(start)
    total = np.asarray(slope) - (np.asarray(found.centre) - anchor.mean) @ anchor.precision
    assert np.abs(total * sd).max() < 1e-2


def test_a_first_guess_is_near_the_truth() -> None:
    guess = first_guess(prepared("impact"))
    # Noise of half a percent of the peak, offset and gain unknown: K and C to a few percent.
    np.testing.assert_allclose(guess[:, 0], np.log(3000.0), atol=0.1)
    np.testing.assert_allclose(guess[:, 1], np.log(25.0), atol=0.3)


@pytest.mark.parametrize("size", [2, 4])
def test_points_are_of_the_product_of_summary_and_population(size: int) -> None:
    summaries, anchor = summaries_of(size)
    z = np.concatenate([np.zeros((1, size)), np.eye(size)])
    mean, *axes = normals(summaries, anchor).at(z[:, None])
    root = np.stack(axes, axis=-1) - mean[..., None]
    covariance = np.linalg.inv(np.asarray(summaries.precision) + anchor.precision)
    np.testing.assert_allclose(root @ root.swapaxes(1, 2), covariance, rtol=1e-9, atol=1e-12)
    # Log of the product falls off from the mean on every side alike.
    step = 0.3 * np.random.default_rng(1).standard_normal(mean.shape)
    product = [summaries.log_density(u) + anchor.log_density(u) for u in (mean + step, mean - step)]
    np.testing.assert_allclose(product[0], product[1], rtol=1e-9)


def test_the_evidence_of_a_summary_is_its_integral() -> None:
    summaries, anchor = summaries_of(3)
    found = log_evidence(summaries, anchor)
    # exp(g s - s' P s / 2) about m is a normal density times a constant.
    for i in range(len(found)):
        centre, slope, precision, level = (np.asarray(part)[i] for part in summaries)
        inverse = np.linalg.inv(precision)
        constant = slope @ inverse @ slope / 2 + np.log(np.linalg.det(2 * np.pi * inverse)) / 2
        away = centre + inverse @ slope
        overlap = multivariate_normal(anchor.mean[i], inverse + np.linalg.inv(anchor.precision)).logpdf(away)
        np.testing.assert_allclose(found[i], level + constant + overlap, rtol=1e-9)


def test_an_expansion_that_bends_the_wrong_way_promises_little() -> None:
    slope = np.array([0.5, 7.0, -14.0, 3.0])
    bend = np.array([-3.0, 1e-9, -60.0, 0.0])
    firm = np.asarray(curvature_floor(bend, slope))
    gain = slope**2 / (2 * firm)
    np.testing.assert_allclose(gain, 1.0, rtol=1e-12)


def test_an_expansion_that_bends_as_it_should_stays() -> None:
    # Up to a maximum that is six standard deviations away.
    slope, bend = np.array([0.0, 6.0, 0.1]), np.array([2.0, 1.0, 1e-3])
    np.testing.assert_array_equal(curvature_floor(bend, slope), bend)


def test_a_flat_likelihood_keeps_a_trace_of_a_bend() -> None:
    assert (np.asarray(curvature_floor(np.zeros(2), np.zeros(2))) > 0).all()
