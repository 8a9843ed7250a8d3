"""Chains of independent proposals, on a posterior that is known."""

from __future__ import annotations

import arviz as az
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
import xarray as xr
from scipy.special import digamma, polygamma

from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.samplers.independence import (
    LEAST_EFFECTIVE,
    IndependenceDraws,
    independence_chains,
)

COUNT, MEAN, SQUARE = 60.0, 0.1, 0.04


def model(count: float) -> None:
    """Mean and precision of ``count`` normal values of known mean and mean square, with a conjugate prior."""
    moved, log_precision = numpyro.sample("y", dist.ImproperUniform(dist.constraints.real_vector, (), (2,)))
    mean, precision = MEAN + moved, jnp.exp(log_precision) / SQUARE
    numpyro.factor("priors", dist.Gamma(1.0, 0.1).log_prob(precision) + log_precision)
    numpyro.factor("prior", dist.Normal(0.0, 10.0).log_prob(mean))
    numpyro.factor("values", count * (jnp.log(precision) - precision * (SQUARE + (mean - MEAN) ** 2)) / 2)


@pytest.fixture(scope="module")
def found() -> IndependenceDraws:
    # Deliberately half as wide as the posterior: the moments must find it.
    covariance = np.diag([SQUARE / COUNT, 2 / COUNT]) / 4
    return independence_chains(model, (COUNT,), "y", covariance, Sampler(chains=4, draws=1000), 1)


def test_the_draws_have_the_known_moments(found: IndependenceDraws) -> None:
    y = found.draws.sites["y"]
    sites = {"mean": MEAN + y[..., 0], "precision": y[..., 1] - np.log(SQUARE)}
    draws = xr.Dataset({name: (("chain", "draw"), values) for name, values in sites.items()})
    size = az.ess(draws)
    assert min(float(size[name]) for name in sites) > 2000
    assert max(float(az.rhat(draws)[name]) for name in sites) < 1.01
    assert found.pareto_k < 0.7
    # The mean integrated out, up to its wide prior: Gamma(1 + (n - 1) / 2, 0.1 + n s^2 / 2).
    shape, rate = 1 + (COUNT - 1) / 2, 0.1 + COUNT * SQUARE / 2
    precision = np.exp(sites["precision"])
    error = np.sqrt(shape) / rate / np.sqrt(float(size["precision"]))
    assert abs(precision.mean() - shape / rate) < 4 * error
    # Given the precision normal about the values' mean; its variance is E[1 / (n precision)].
    variance = rate / (shape - 1) / COUNT
    assert abs(sites["mean"].mean() - MEAN) < 4 * np.sqrt(variance / float(size["mean"]))


def test_statistics_are_those_of_the_sampler_that_others_read(found: IndependenceDraws) -> None:
    statistics = found.draws.statistics
    assert set(statistics) == {"diverging", "num_steps", "accept_prob", "energy", "potential_energy"}
    assert {values.shape for values in statistics.values()} == {(4, 1000)}
    assert not statistics["diverging"].any()
    assert 0.5 < statistics["accept_prob"].mean() <= 1


def test_proposals_that_miss_the_posterior_say_so() -> None:
    def far(shift: float) -> None:
        # Two ridges far apart: the start knows of one only.
        (x,) = numpyro.sample("x", dist.Normal(jnp.zeros(1), 1.0).to_event(1))
        numpyro.factor("ridges", jnp.logaddexp(-((x / 0.01) ** 2), 4 - jnp.abs(x) / shift) + x**2 / 2)

    found = independence_chains(far, (30.0,), "x", np.array([[1e-4]]), Sampler(chains=2, draws=500), 2)
    assert found.pareto_k > 0.7 or np.abs(found.draws.sites["x"]).max() > 10


def test_draws_are_nearly_independent_down_to_the_least_effective_share_that_serves() -> None:
    def skewed(shape: float) -> None:
        # Logarithms of gamma variables, about their modes: independent, each skewed to the left.
        x = numpyro.sample("x", dist.ImproperUniform(dist.constraints.real_vector, (), (7,)))
        numpyro.factor("gammas", shape * (x - jnp.exp(x)).sum())

    shape = 3.0
    sampler = Sampler(chains=4, draws=1000)
    found = independence_chains(skewed, (shape,), "x", np.eye(7) / shape, sampler, 3)
    assert LEAST_EFFECTIVE < found.effective < 0.5
    draws = xr.Dataset({"x": (("chain", "draw", "part"), found.draws.sites["x"])})
    size = az.ess(draws)["x"].to_numpy()
    assert size.min() > 2000
    # E[log Gamma(a, a)] = digamma(a) - log(a), its variance trigamma(a).
    error = np.sqrt(polygamma(1, shape) / size)
    mean = found.draws.sites["x"].mean((0, 1))
    assert (np.abs(mean - (digamma(shape) - np.log(shape))) < 4 * error).all()
