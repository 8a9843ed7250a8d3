from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from bayestissue.hierarchy.published import log_density_of_averages, log_density_of_estimates
from bayestissue.likelihood.averages import AveragesOfLognormals

RNG = np.random.default_rng(5)
PEOPLE = 6
EXPECTED = np.array([2.5, 0.3]) + 0.2 * RNG.standard_normal((PEOPLE, 2))
SCALE = np.array([[0.3, 0.0], [-0.2, 0.4]])
SD_TRIAL = np.array([0.25, 0.4])
EFFECT = np.array([0.2, -0.3])


def test_estimates_of_a_new_trial_have_one_large_covariance() -> None:
    logs = EXPECTED + EFFECT + RNG.standard_normal((PEOPLE, 2)) @ SCALE.T
    within = SCALE @ SCALE.T
    covariance = np.zeros((2 * PEOPLE, 2 * PEOPLE))
    for i in range(PEOPLE):
        for j in range(PEOPLE):
            block = np.diag(SD_TRIAL**2) + (within if i == j else 0)
            covariance[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
    direct = multivariate_normal(EXPECTED.ravel(), covariance).logpdf(logs.ravel())
    ours = log_density_of_estimates(*map(jnp.asarray, (EXPECTED, SCALE, SD_TRIAL, logs)))
    assert_allclose(ours, direct, rtol=1e-11)


def test_estimates_of_a_new_trial_by_averaging_over_its_effect() -> None:
    logs = EXPECTED + EFFECT + RNG.standard_normal((PEOPLE, 2)) @ SCALE.T
    effects = SD_TRIAL * RNG.standard_normal((200_000, 2))
    within = multivariate_normal([0, 0], SCALE @ SCALE.T)
    given = sum(within.logpdf(logs[i] - EXPECTED[i] - effects) for i in range(PEOPLE))
    weight = np.exp(given - given.max())
    brute = logsumexp(given) - np.log(len(given))
    # Delta method: the standard error of a log mean is the relative standard error of the mean.
    error = weight.std() / weight.mean() / np.sqrt(len(weight))
    ours = log_density_of_estimates(*map(jnp.asarray, (EXPECTED, SCALE, SD_TRIAL, logs)))
    assert abs(float(ours) - brute) < 4 * error


def test_averages_of_a_new_trial_by_quadrature_over_its_effect() -> None:
    scale = jnp.asarray(SCALE)
    observed = jnp.asarray(
        AveragesOfLognormals(jnp.asarray(EXPECTED + EFFECT), scale).sample(jax.random.key(0))
    )
    # A grid over both effects, eight standard deviations wide: exact for smooth decaying integrands.
    z = np.linspace(-8, 8, 201)
    shifts = np.stack(np.meshgrid(*(z[:, None] * SD_TRIAL).T, indexing="ij"), -1).reshape(-1, 2)
    log_weight = norm(scale=SD_TRIAL).logpdf(shifts).sum(-1)
    given = jax.vmap(
        lambda shift: AveragesOfLognormals(jnp.asarray(EXPECTED) + shift, scale).log_prob(observed)
    )(jnp.asarray(shifts))
    cell = np.prod((z[1] - z[0]) * SD_TRIAL)
    direct = logsumexp(np.asarray(given) + log_weight) + np.log(cell)
    ours = log_density_of_averages(jnp.asarray(EXPECTED), scale, jnp.asarray(SD_TRIAL), observed)
    assert_allclose(ours, direct, atol=1e-6)


def test_without_a_trial_effect_the_estimates_are_independent() -> None:
    logs = EXPECTED + RNG.standard_normal((PEOPLE, 2)) @ SCALE.T
    within = multivariate_normal([0, 0], SCALE @ SCALE.T)
    ours = log_density_of_estimates(*map(jnp.asarray, (EXPECTED, SCALE, np.zeros(2), logs)))
    assert_allclose(ours, within.logpdf(logs - EXPECTED).sum(), rtol=1e-11)
