"""Autoregressive noise of the recorder, against the whole covariance."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal

from bayestissue.elements import element, impact
from bayestissue.elements.element import Element
from bayestissue.likelihood.element import noise
from bayestissue.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.likelihood.element.record import Contact, DecelerationRecord
from bayestissue.likelihood.element.response import Response, columns, response

MASS, VELOCITY = np.array([0.5, 1.2]), np.array([1.5, 1.0])
DT, FIRST = np.array([4e-4, 5e-4]), np.array([1e-4, 4e-4])
COUNT = np.array([38, 45])
SD = np.array([[0.01, 0.02, 0.5, 1e-4], [0.02, 0.01, 0.2, 5e-5]])
LOG_SIGMA = jnp.log(jnp.array([0.4, 0.6]))
RHO = np.array([0.6, -0.3])
A = jnp.arctanh(jnp.asarray(RHO))
QUIET = np.array([True, False])
EXTRA = {"K": 2500.0, "C": 30.0, "stiffening_depth_m": 0.015}


def measured(name: str, a: jax.Array | None = A, *, uniform: bool = False) -> MeasuredImpact:
    """Recordings of a stiffening element, taken for those of the named one."""
    time = FIRST[:, None] + DT[:, None] * np.arange(COUNT.max())
    d = np.array(impact("stiffening", EXTRA, MASS, 0.99 * VELOCITY, time).deceleration) + 0.3
    d += 0.5 * np.random.default_rng(4).standard_normal(d.shape)
    contact = Contact.known(np.array([uniform, False]))
    ball = {"diameter_m": np.full(2, 0.0318)}
    record = DecelerationRecord.from_arrays(d, COUNT, FIRST, DT, VELOCITY, SD, MASS, ball, contact)
    which = element(name)
    parameters = jnp.array([np.full(2, EXTRA[each.name]) for each in which.parameters])
    found = record._replace(quiet=jnp.asarray(QUIET))
    return MeasuredImpact(which, parameters, NoiseParameters(LOG_SIGMA, None, a), found)


@partial(jax.jit, static_argnums=0)
def _log_prob(
    which: Element, parameters: jax.Array, noise: NoiseParameters, record: DecelerationRecord
) -> jax.Array:
    return MeasuredImpact(which, parameters, noise, record).log_density()


@partial(jax.jit, static_argnums=0)
def _response(*given: Any) -> Response:
    return response(*given)


def response_of(given: MeasuredImpact) -> Response:
    return _response(given.element, given.parameters, given.record)


def log_prob(name: str, a: jax.Array | None = A) -> jax.Array:
    given = measured(name)
    return _log_prob(given.element, given.parameters, NoiseParameters(LOG_SIGMA, None, a), given.record)


def noise_covariance(row: int) -> np.ndarray:
    """sigma^2 rho^|s - t| / (1 - rho^2)."""
    variance = np.exp(2 * LOG_SIGMA[row]) / (1 - RHO[row] ** 2)
    return variance * toeplitz(RHO[row] ** np.arange(COUNT[row]))


def error_sd(row: int) -> np.ndarray:
    """The offset of the first was found in a quiet part, whose mean is less sure than of white noise."""
    longer = np.sqrt((1 + RHO[row]) / (1 - RHO[row])) if QUIET[row] else 1.0
    return SD[row] * [1, 1, longer, 1]


def dense(given: MeasuredImpact, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Residual and covariance of a trace, the errors' columns in it."""
    n, found = COUNT[row], response_of(given)
    each = np.stack([np.asarray(column)[row, :n] for column in columns(found, given.record)], axis=1)
    each = each * error_sd(row)
    return np.asarray(given.record.d - found.d)[row, :n], noise_covariance(row) + each @ each.T


def test_whitened_parts_have_the_products_of_the_inverse_covariance() -> None:
    random = np.random.default_rng(0)
    inside = np.arange(50) < COUNT[:, None]
    p, q = np.where(inside, random.normal(size=(2, *inside.shape)), 0.0)
    white = [np.asarray(noise.whitened(jnp.asarray(part), A, jnp.asarray(inside))) for part in (p, q)]
    determinant = noise.log_determinant(A)
    for row, n in enumerate(COUNT):
        assert not white[0][row, n:].any()
        shape = toeplitz(RHO[row] ** np.arange(n)) / (1 - RHO[row] ** 2)
        expected = p[row, :n] @ np.linalg.solve(shape, q[row, :n])
        # Sums of some forty numbers of order one.
        assert_allclose((white[0] * white[1])[row].sum(), expected, atol=1e-12)
        assert_allclose(determinant[row], np.linalg.slogdet(shape)[1], atol=1e-12)


def test_the_determinant_does_not_overflow_near_a_correlation_of_one() -> None:
    far = jnp.array([-40.0, 40.0])
    assert_allclose(noise.log_determinant(far), 80 - 2 * np.log(2), rtol=1e-14)


def test_correlated_is_the_inverse_of_whitened() -> None:
    standard = jnp.asarray(np.random.default_rng(0).normal(size=(2, 30)))
    shocks = noise.correlated(standard, A)
    everywhere = jnp.ones(standard.shape, bool)
    assert_allclose(noise.whitened(shocks, A, everywhere), standard, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kelvin_voigt", "stiffening"])
def test_density_is_that_of_the_whole_covariance(name: str) -> None:
    given, found = measured(name), log_prob(name)
    for row in range(2):
        residual, covariance = dense(given, row)
        expected = multivariate_normal(np.zeros(len(residual)), covariance).logpdf(residual)
        # Products of columns up to 1e5 beside noise of order one.
        assert_allclose(found[row], expected, rtol=1e-10)


@pytest.mark.slow
def test_no_correlation_is_white_noise() -> None:
    white, none = measured("kelvin_voigt", None), measured("kelvin_voigt", jnp.zeros(2))
    assert_allclose(log_prob("kelvin_voigt", jnp.zeros(2)), log_prob("kelvin_voigt", None), rtol=1e-13)
    key = jax.random.PRNGKey(0)
    assert_allclose(*jax.jit(lambda key: (none.sample(key), white.sample(key)))(key), rtol=1e-13)


@pytest.mark.slow
def test_slopes_agree_with_differences() -> None:
    given = measured("kelvin_voigt", uniform=True)
    which, record = given.element, given.record

    @jax.jit
    @partial(jax.value_and_grad, has_aux=True)
    def at(logs: jax.Array) -> tuple[jax.Array, jax.Array]:
        noise = NoiseParameters(logs[-2], None, logs[-1])
        made = MeasuredImpact(which, jnp.exp(logs[:-2]), noise, record)
        found = made.log_density()
        return found.sum(), found

    logs = np.concatenate([np.log(given.parameters), LOG_SIGMA[None], A[None]])
    _, slopes = at(logs)
    step = 1e-5
    for k in range(len(logs)):
        change = step * (np.arange(len(logs)) == k)[:, None]
        ahead, behind = (at(logs + side * change)[0][1] for side in (1, -1))
        difference = (ahead - behind) / (2 * step)
        # Densities of about 100 are good to 1e-13, their differences over 2e-5 to 1e-6.
        assert_allclose(slopes[k], difference, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_samples_have_the_covariance_of_noise_and_chain() -> None:
    given, number = measured("kelvin_voigt"), 4000
    sample = jax.jit(lambda key: given.sample(key, (number,)))
    drawn = np.asarray(sample(jax.random.PRNGKey(0))) - np.asarray(response_of(given).d)
    for row, n in enumerate(COUNT):
        assert not drawn[:, row, n:].any()
        _, covariance = dense(given, row)
        scale = np.sqrt(np.diag(covariance))
        expected = covariance / np.outer(scale, scale)
        found = drawn[:, row, :n] / scale
        found = found.T @ found / number
        # Of normals, (1 + r^2) / number is the variance of a product's mean; a thousand of them.
        assert np.abs((found - expected) / np.sqrt((1 + expected**2) / number)).max() < 5.5


def test_noise_has_its_autocovariance() -> None:
    count, number = 60, 4000
    standard = jax.random.normal(jax.random.PRNGKey(1), (number, 2, count))
    shocks = np.asarray(noise.correlated(standard, A))
    for row, rho in enumerate(RHO):
        for lag in range(4):
            # One product a series and place, all series independent.
            each = (shocks[:, row, lag:] * shocks[:, row, : count - lag]).mean(1)
            error = each.std() / np.sqrt(number)
            assert abs(each.mean() - rho**lag / (1 - rho**2)) < 5 * error


def test_errors_given_a_trace_are_those_of_the_joint_normal() -> None:
    given, number = measured("kelvin_voigt"), 4000
    drawn = np.asarray(jax.jit(jax.vmap(given.draw_errors))(jax.random.split(jax.random.PRNGKey(2), number)))
    for row, n in enumerate(COUNT):
        residual, covariance = dense(given, row)
        each = np.stack([np.asarray(c)[row, :n] for c in columns(response_of(given), given.record)], axis=1)
        across = error_sd(row)[:, None] ** 2 * each.T
        weights = np.linalg.solve(covariance, across.T).T
        spread = np.diag(error_sd(row) ** 2) - weights @ across.T
        sd = np.sqrt(np.diag(spread))
        # Eight means and variances: five standard errors each.
        assert np.abs((drawn[:, row].mean(0) - weights @ residual) / sd).max() < 5 / np.sqrt(number)
        assert np.abs(drawn[:, row].var(0) / sd**2 - 1).max() < 5 * np.sqrt(2 / number)
