from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayestissue.model.likelihood.linear_errors import Errors, Products, draw_errors, marginal_log_likelihood

RNG = np.random.default_rng(1)
IMPACTS, COUNT, ERRORS = 3, 9, 3
RESIDUAL = RNG.normal(size=(IMPACTS, COUNT))
COLUMNS = RNG.normal(size=(ERRORS, IMPACTS, COUNT))
WEIGHT = RNG.uniform(0.5, 2.0, size=(IMPACTS, COUNT))
LOG_SIGMA = np.array([-0.5, 0.3, 0.0])
ERROR_SD = np.array([[0.7, 1.2, 0.3], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])


def products() -> Products:
    parts = np.stack([RESIDUAL, *COLUMNS])
    gram = jnp.asarray(np.einsum("aik,bik,ik->abi", parts, parts, WEIGHT))
    return Products.of_unit_noise(
        gram, -jnp.log(jnp.asarray(WEIGHT)).sum(1), jnp.full(IMPACTS, float(COUNT)), jnp.asarray(LOG_SIGMA)
    )


def dense(i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The errors' covariance, their columns, and the trace's covariance."""
    errors, columns = np.diag(ERROR_SD[i] ** 2), COLUMNS[:, i].T
    return errors, columns, np.exp(2 * LOG_SIGMA[i]) * np.diag(1 / WEIGHT[i]) + columns @ errors @ columns.T


def test_density_is_that_of_the_dense_normal() -> None:
    ours = marginal_log_likelihood(products(), Errors(jnp.asarray(ERROR_SD), jnp.zeros(IMPACTS, bool)))
    direct = [multivariate_normal(cov=dense(i)[2]).logpdf(RESIDUAL[i]) for i in range(IMPACTS)]
    assert_allclose(ours, direct, rtol=1e-12)


def test_errors_are_drawn_from_their_dense_conditional() -> None:
    number = 20_000
    keys = jax.random.split(jax.random.key(4), number)
    arguments = (products(), Errors(jnp.asarray(ERROR_SD), jnp.zeros(IMPACTS, bool)))
    drawn = np.asarray(jax.vmap(lambda key: draw_errors(key, *arguments))(keys))
    for i in range(IMPACTS):
        errors, columns, covariance = dense(i)
        gain = errors @ columns.T @ np.linalg.inv(covariance)
        mean, left = gain @ RESIDUAL[i], errors - gain @ columns @ errors
        sd = np.sqrt(np.maximum(np.diag(left), 0))
        # Standard errors of a mean, sd / sqrt(n), and of a covariance, at most sqrt(2) sd sd / sqrt(n).
        assert (np.abs(drawn[:, i].mean(0) - mean) <= 4.5 * sd / np.sqrt(number)).all()
        scatter = np.cov(drawn[:, i].T)
        assert (np.abs(scatter - left) <= 4.5 * np.sqrt(2 / number) * np.outer(sd, sd) + 1e-15).all()


def test_a_uniform_error_is_integrated_over_and_drawn_within_its_bounds() -> None:
    sd = np.array([[0.7, 1.2, 0.3], [0.4, 0.5, 2.0], [0.0, 0.0, 1e-3]])
    half = np.sqrt(3) * sd[:, -1]
    places, weights = np.polynomial.legendre.leggauss(200)
    uniform = jnp.array([True, True, True])
    arguments = (products(), Errors(jnp.asarray(sd), uniform))
    ours = np.asarray(marginal_log_likelihood(*arguments))
    number = 20_000
    keys = jax.random.split(jax.random.key(5), number)
    drawn = np.asarray(jax.vmap(lambda key: draw_errors(key, *arguments))(keys))[..., -1]
    for i in range(IMPACTS):
        columns, errors = COLUMNS[:2, i].T, np.diag(sd[i, :2] ** 2)
        covariance = np.exp(2 * LOG_SIGMA[i]) * np.diag(1 / WEIGHT[i]) + columns @ errors @ columns.T
        at = half[i] * places
        density = multivariate_normal(cov=covariance).logpdf(RESIDUAL[i] - at[:, None] * COLUMNS[2, i])
        assert_allclose(ours[i], logsumexp(density, b=weights / 2), rtol=1e-10)
        share = weights * np.exp(density - density.max())
        share /= share.sum()
        mean = share @ at
        sd_left = np.sqrt(share @ (at - mean) ** 2)
        assert (np.abs(drawn[:, i]) <= half[i] * (1 + 1e-12)).all()
        # Standard errors of a mean and, at most, of a standard deviation.
        assert abs(drawn[:, i].mean() - mean) < 4.5 * sd_left / np.sqrt(number)
        assert abs(drawn[:, i].std() - sd_left) < 4.5 * sd_left / np.sqrt(number)
