from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal
from statsmodels.tsa.arima.model import ARIMA
from statsmodels.tsa.arima_process import arma_acovf

from bayestissue.mechanics.oscillator import to_discrete
from bayestissue.model.likelihood import arma21
from bayestissue.model.likelihood.arma21 import arma21_log_likelihood

THETAS = [-1.0, -0.999, -0.27, 0.0, 0.5, 1.0, 1.3]
COMPLEX, REAL = (1.9, -0.92), (1.6, -0.62)
FINE = tuple(float(c) for c in to_discrete(0.01, 0.3, 1.0)[:2])


def walk(n: int = 50, seed: int = 1) -> np.ndarray:
    return 0.1 * np.random.default_rng(seed).normal(size=n).cumsum()


def dense_free(x: np.ndarray, phi: tuple[float, float], theta1: float, sigma_a: float) -> float:
    w = x[2:] - phi[0] * x[1:-1] - phi[1] * x[:-2]
    near = np.eye(len(w), k=1) + np.eye(len(w), k=-1)
    covariance = sigma_a**2 * ((1 + theta1**2) * np.eye(len(w)) - theta1 * near)
    return float(multivariate_normal(np.zeros(len(w)), covariance).logpdf(w))


def dense_stationary(x: np.ndarray, phi: tuple[float, float], theta1: float, sigma_a: float) -> float:
    gamma = arma_acovf([1, -phi[0], -phi[1]], [1, -theta1], len(x), sigma_a**2)
    covariance = gamma[np.abs(np.subtract.outer(np.arange(len(x)), np.arange(len(x))))]
    return float(multivariate_normal(np.zeros(len(x)), covariance).logpdf(x))


@pytest.mark.parametrize("phi", [COMPLEX, REAL, FINE])
@pytest.mark.parametrize("theta1", THETAS)
def test_free_start_is_the_dense_normal(theta1: float, phi: tuple[float, float]) -> None:
    x = walk()
    expected = dense_free(x, phi, theta1, 0.3)
    # at |theta1| = 1 the dense matrix has a condition number of about N^2
    assert float(arma21_log_likelihood(x, *phi, theta1, 0.3)) == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("phi", [COMPLEX, REAL])
@pytest.mark.parametrize("theta1", [-0.6, 0.0, 1.0, 1.3])
def test_stationary_start_is_the_dense_normal(theta1: float, phi: tuple[float, float]) -> None:
    x = walk()
    expected = dense_stationary(x, phi, theta1, 0.3)
    # the dense covariance loses up to seven digits to its condition number
    assert float(arma21_log_likelihood(x, *phi, theta1, 0.3, start="stationary")) == pytest.approx(
        expected, rel=1e-9
    )


@pytest.mark.parametrize(("omega_dt", "zeta"), [(0.5, 1.0), (0.5, 2.0), (0.05, 0.3)])
def test_stationary_start_is_the_one_of_statsmodels(omega_dt: float, zeta: float) -> None:
    x = walk(200)
    phi1, phi2, theta1 = (float(c) for c in to_discrete(omega_dt, zeta, 1.0))
    model = ARIMA(x, order=(2, 0, 1), trend="n", enforce_invertibility=False)
    expected = model.loglike([phi1, phi2, -theta1, 0.09])
    ours = arma21_log_likelihood(x, phi1, phi2, theta1, 0.3, start="stationary")
    # its Kalman filter stops updating the variance once that has converged, at a tolerance of 1e-9 or so
    assert float(ours) == pytest.approx(expected, rel=1e-8)


log_determinant = jax.jit(arma21.log_determinant)


@pytest.mark.parametrize("theta1", [-1.3, -1.0, -0.9999, -0.5, 0.0, 1.0])
@pytest.mark.parametrize("count", [1, 7, 4000])
def test_determinant_is_the_sum_of_even_powers(theta1: float, count: int) -> None:
    expected = np.logaddexp.reduce(2 * np.arange(count + 1) * np.log(max(abs(theta1), 1e-300)))
    assert float(log_determinant(theta1, float(count))) == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["free", "stationary"])
def test_derivatives_match_finite_differences(start: str) -> None:
    x = np.stack([walk(80, seed) for seed in range(7)])
    columns = jnp.stack([jnp.full(7, 0.1), jnp.full(7, 0.02), jnp.array(THETAS), jnp.full(7, 0.3)])

    @jax.jit
    def each(p: jax.Array) -> jax.Array:
        # By c1 = 2 - phi1 and c2 = 1 - phi1 - phi2, in which no digits cancel.
        c1, c2, *rest = p
        return arma21_log_likelihood(x, 2 - c1, c1 - c2 - 1, *rest, start=start)  # type: ignore[arg-type]

    total = jax.jit(jax.grad(lambda p: each(p).sum()))
    steps = np.array([1e-6, 1e-7, 1e-5, 1e-6])
    finite = []
    for k, step in enumerate(steps):
        shift = jnp.zeros((4, 1)).at[k].set(step)
        finite.append((each(columns + shift) - each(columns - shift)) / (2 * step))
    # central differences: rounding 1e-16 |l| / step and step^2 of a third derivative
    np.testing.assert_allclose(total(columns), finite, rtol=2e-6, atol=2e-4)


def test_no_stationary_distribution_has_no_density() -> None:
    assert float(arma21_log_likelihood(walk(), 2.1, -1.05, 0.0, 1.0, start="stationary")) == -np.inf


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="three samples"):
        arma21_log_likelihood([1.0, 2.0], 1.0, 0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="stationary"):
        arma21_log_likelihood([1.0, 2.0, 3.0], 1.0, 0.0, 0.0, 1.0, start="frozen")
    with pytest.raises(ValueError, match="3 to 4 samples"):
        arma21.transformed(np.zeros((2, 4)), np.array([4, 2]), 1)
