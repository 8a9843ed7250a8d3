from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal

from bayestissue.mechanics.oscillator import to_differences
from bayestissue.model.likelihood.displacements import (
    DisplacementRecord,
    MeasuredDisplacement,
    displacement_record,
)

RNG = np.random.default_rng(7)
LENGTHS = np.array([3, 40, 12, 30, 23])
DT = np.array([1e-3, 1e-3, 2e-3, 5e-4, 1e-3])
FIRST = np.array([0.0, 3e-4, 1e-3, 2e-4, 5e-4])
# Real roots, equal roots and complex ones.
OMEGA_N = np.array([80.0, 60.0, 150.0, 90.0, 40.0])
ZETA = np.array([0.3, 1.0, 2.5, 0.05, 0.7])
THETA1 = np.array([-1.0, 0.9, -1.0, 0.2, -0.97])
GRAVITY = np.array([9.80665, 0.0, 9.80665, -3.0, 9.80665])
LOG_SIGMA = np.log(np.array([2e-5, 1e-5, 3e-5, 1e-5, 2e-5]))
ERROR_SD = np.array(
    [[1e-4, 0.02, 0.5], [1e-3, 0.0, 0.3], [0.0, 0.0, 0.0], [2e-4, 0.01, 2.0], [0.0, 0.03, 0.0]]
)


def record(error_sd: np.ndarray = ERROR_SD) -> DisplacementRecord:
    x = 1e-3 * np.sin(np.arange(40) / 12) + 1e-5 * RNG.normal(size=(5, 40)).cumsum(1)
    return displacement_record(x, LENGTHS, FIRST, DT, error_sd, GRAVITY)


RECORD = record()


def parameters(theta1: np.ndarray | None = THETA1) -> tuple[jax.Array | None, ...]:
    return tuple(None if p is None else jnp.asarray(p) for p in (OMEGA_N, ZETA, theta1, LOG_SIGMA))


def measured() -> MeasuredDisplacement:
    return MeasuredDisplacement(*parameters(), RECORD)  # type: ignore[arg-type]


@jax.jit
def densities(*parts: jax.Array | None) -> jax.Array:
    return MeasuredDisplacement(*parts, RECORD).log_density()  # type: ignore[arg-type]


def filtered(x: np.ndarray, i: int) -> np.ndarray:
    """x_t - phi1 x_{t-1} - phi2 x_{t-2} from the textbook's coefficients."""
    c1, c2, _ = (float(c) for c in to_differences(OMEGA_N[i], ZETA[i], DT[i]))
    phi1, phi2 = 2 - c1, c1 - c2 - 1
    return x[..., 2:] - phi1 * x[..., 1:-1] - phi2 * x[..., :-2]


def dense(i: int, theta1: float, error_sd: np.ndarray = ERROR_SD) -> tuple[np.ndarray, np.ndarray]:
    """The covariance of w and what the chain's errors add to w, [error, value]."""
    n, time = LENGTHS[i], FIRST[i] + np.arange(LENGTHS[i]) * DT[i]
    band = np.zeros(n - 2)
    band[0] = 1 + theta1**2
    band[1:2] = -theta1
    columns = filtered(np.stack([np.ones(n), time, time**2 / 2]), i)
    noise = np.exp(2 * LOG_SIGMA[i]) * toeplitz(band)
    return noise + columns.T @ np.diag(error_sd[i] ** 2) @ columns, columns


def dense_log_density(x: np.ndarray, theta1: np.ndarray) -> list[float]:
    rows = [filtered(x[i, : LENGTHS[i]] - GRAVITY[i] / OMEGA_N[i] ** 2, i) for i in range(5)]
    return [multivariate_normal(cov=dense(i, theta1[i])[0]).logpdf(rows[i]) for i in range(5)]


def test_density_is_that_of_the_dense_normal() -> None:
    # The dense oracle's coefficients near 2 and 1 lose (omega_n dt)^2 of their digits.
    assert_allclose(densities(*parameters()), dense_log_density(np.asarray(RECORD.x), THETA1), rtol=1e-8)


def test_a_gain_of_all_impacts_bends_the_traces_as_two_integrations_have_it() -> None:
    velocity, gain = np.array([1.5, 1.2, 0.7, 1.0, 2.0]), np.array([0.02, -0.03, 0.05, 0.0, -0.01])
    time = FIRST[:, None] + np.arange(40) * DT[:, None]
    x = np.asarray(RECORD.x)
    # (1 + g) d integrated twice and taken off V t and gravity's part.
    added = gain[:, None] * (velocity[:, None] * time + GRAVITY[:, None] * time**2 / 2)
    of = replace(measured(), record=RECORD._replace(velocity=jnp.asarray(velocity)))
    with_gain = replace(of, log_gain=jnp.log1p(gain))
    expected = dense_log_density(x + added, THETA1)
    assert_allclose(with_gain.log_density(), expected, rtol=1e-8)
    shocks = np.exp(2 * LOG_SIGMA) * with_gain.products().gram[0][0]
    assert_allclose(shocks, squares_of_channel(with_gain), rtol=1e-6)


def squares_of_channel(of: MeasuredDisplacement) -> np.ndarray:
    """Sum of squares of the residual over its noise, frequency by frequency."""
    channel = of.channels()[0]
    white = np.asarray(channel.residual)[:, 0] ** 2 / np.asarray(channel.noise.eigenvalue)
    return np.where(np.asarray(channel.noise.inside), white, 0.0).sum(1)


@pytest.mark.slow
def test_sampled_a2_takes_theta1_from_the_oscillator() -> None:
    theta1 = np.asarray(to_differences(OMEGA_N, ZETA, DT).theta1)
    found = densities(*parameters(None))
    assert_allclose(found, densities(*parameters(theta1)), rtol=1e-13)
    assert_allclose(found, dense_log_density(np.asarray(RECORD.x), theta1), rtol=1e-8)


def test_other_traces_have_their_own_density_and_what_lies_past_their_end_counts_nothing() -> None:
    other = np.where(np.arange(40) < LENGTHS[:, None], 1.1 * np.asarray(RECORD.x), 7.0)
    found = replace(measured(), record=RECORD.with_traces(other)).log_density()
    assert_allclose(found, dense_log_density(other, THETA1), rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("theta1", [None, THETA1])
def test_slopes_are_central_differences(theta1: np.ndarray | None) -> None:
    at = [p for p in parameters(theta1) if p is not None]

    def given(*parts: jax.Array) -> jax.Array:
        return densities(*parts[:2], parts[2] if theta1 is not None else None, parts[-1])

    @jax.jit
    def both(*at: jax.Array) -> tuple[tuple[jax.Array, ...], jax.Array]:
        slopes = jax.grad(lambda *parts: given(*parts).sum(), argnums=tuple(range(len(at))))(*at)
        return slopes, jax.jvp(given, at, tuple(map(jnp.ones_like, at)))[1]

    slopes, forward = both(*at)
    # Each impact's density follows its own parameters only.
    assert_allclose(forward, sum(slopes), rtol=1e-9, atol=1e-6)
    for k, slope in enumerate(slopes):
        step = 1e-5 * np.maximum(np.abs(at[k]), 0.1)
        ahead, behind = (
            np.asarray(given(*[p + sign * step if a == k else p for a, p in enumerate(at)]))
            for sign in (1, -1)
        )
        # Third derivatives times step squared, and rounding of a density of some hundreds over the step.
        assert_allclose(slope, (ahead - behind) / (2 * step), rtol=2e-6, atol=1e-13 * 500 / step.min())


def test_samples_have_the_dense_mean_and_covariance() -> None:
    number = 4000
    keys = jax.random.split(jax.random.key(2), number)
    x = np.asarray(jax.jit(jax.vmap(measured().replicate))(keys)["displacement"])
    assert_allclose(x[:, :, :2], np.broadcast_to(RECORD.x[:, :2], (number, 5, 2)), atol=1e-15)
    for i in range(5):
        w = filtered(x[:, i, : LENGTHS[i]] - GRAVITY[i] / OMEGA_N[i] ** 2, i)
        covariance, _ = dense(i, THETA1[i])
        sd = np.sqrt(np.diag(covariance))
        # Standard errors of means and of covariances; 5 of them for some thousand numbers.
        assert (np.abs(w.mean(0)) < 5 * sd / np.sqrt(number)).all()
        error = np.sqrt((np.outer(sd, sd) ** 2 + covariance**2) / number)
        assert (np.abs(np.cov(w.T) - covariance) < 5 * error).all()
        assert np.isnan(x[:, i, LENGTHS[i] :]).all()
