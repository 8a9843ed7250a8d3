from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tinygp
from scipy.stats import multivariate_normal
from statsmodels.tsa.arima.model import ARIMA
from statsmodels.tsa.arima_process import arma_acovf

from bayestissue.mechanics.oscillator import to_differences, to_discrete
from bayestissue.model.likelihood import arma21_log_likelihood, sine_transforms
from bayestissue.model.likelihood.arma.arma21 import arma21_series, start_moments

THETAS = [-1.0, -0.999, -0.27, 0.0, 0.5, 1.0, 1.3]
COMPLEX, REAL = (1.9, -0.92), (1.6, -0.62)
FINE = tuple(float(c) for c in to_discrete(0.01, 0.3, 1.0)[:2])


def walk(n: int = 50, seed: int = 1) -> np.ndarray:
    return 0.1 * np.random.default_rng(seed).normal(size=n).cumsum()


def by_differences(
    x: np.ndarray | jax.Array, c1: jax.Array, c2: jax.Array, *rest: jax.Array, start: str = "free"
) -> jax.Array:
    """The density by c1 = 2 - phi1 and c2 = 1 - phi1 - phi2, in which no digits cancel."""
    return arma21_log_likelihood(x, 2 - c1, c1 - c2 - 1, *rest, start=start)  # type: ignore[arg-type]


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
@pytest.mark.parametrize("theta1", [-0.6, -0.27, 0.0, 0.5, 1.0, 1.3])
def test_stationary_start_is_the_dense_normal(theta1: float, phi: tuple[float, float]) -> None:
    x = walk()
    expected = dense_stationary(x, phi, theta1, 0.3)
    # the dense covariance loses up to seven digits to its condition number
    assert float(arma21_log_likelihood(x, *phi, theta1, 0.3, start="stationary")) == pytest.approx(
        expected, rel=1e-9
    )


@pytest.mark.parametrize(("omega_dt", "zeta"), [(0.5, 0.05), (0.5, 0.7), (0.5, 1.0), (0.5, 2.0), (0.05, 0.3)])
def test_stationary_start_is_the_one_of_statsmodels(omega_dt: float, zeta: float) -> None:
    x = walk(200)
    phi1, phi2, theta1 = (float(c) for c in to_discrete(omega_dt, zeta, 1.0))
    model = ARIMA(x, order=(2, 0, 1), trend="n", enforce_invertibility=False)
    expected = model.loglike([phi1, phi2, -theta1, 0.09])
    ours = arma21_log_likelihood(x, phi1, phi2, theta1, 0.3, start="stationary")
    # its Kalman filter stops updating the variance once that has converged, at a tolerance of 1e-9 or so
    assert float(ours) == pytest.approx(expected, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["free", "stationary"])
def test_derivatives_match_finite_differences(start: str) -> None:
    x = np.stack([walk(80, seed) for seed in range(7)])
    columns = jnp.stack([jnp.full(7, 0.1), jnp.full(7, 0.02), jnp.array(THETAS), jnp.full(7, 0.3)])

    @jax.jit
    def each(p: jax.Array) -> jax.Array:
        return by_differences(x, *p, start=start)

    total = jax.jit(jax.grad(lambda p: each(p).sum()))
    steps = np.array([1e-6, 1e-7, 1e-5, 1e-6])
    finite = []
    for k, step in enumerate(steps):
        shift = jnp.zeros((4, 1)).at[k].set(step)
        finite.append((each(columns + shift) - each(columns - shift)) / (2 * step))
    # central differences: rounding 1e-16 |l| / step and step^2 of a third derivative
    np.testing.assert_allclose(total(columns), finite, rtol=2e-6, atol=2e-4)


def test_curvature_matches_differences_of_the_gradient() -> None:
    x = walk(80)
    point, step = jnp.array([0.1, 0.02, -0.4, 0.3]), 1e-5

    def value(p: jax.Array) -> jax.Array:
        return by_differences(x, *p)

    slope = jax.jit(jax.grad(value))
    finite = [(slope(point + step * e) - slope(point - step * e)) / (2 * step) for e in jnp.eye(4)]
    np.testing.assert_allclose(jax.jit(jax.hessian(value))(point), finite, rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize("theta1", [-1.0, 1.0])
def test_gradient_is_clean_where_theta1_turns_non_invertible(theta1: float) -> None:
    # theta1 -> 1/theta1 with sigma_a -> sigma_a theta1 leaves the density: fixes the slope at the edge
    x = walk()

    def value(log_theta: jax.Array) -> jax.Array:
        ratio = jnp.exp(log_theta)
        return arma21_log_likelihood(x, *COMPLEX, theta1 * ratio, 0.3 / jnp.sqrt(ratio))

    assert float(jax.grad(value)(jnp.array(0.0))) == pytest.approx(0.0, abs=1e-8)
    near = [float(jax.grad(value)(jnp.array(side))) for side in (-1e-6, 1e-6)]
    assert near[0] == pytest.approx(-near[1], rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("zeta", [0.1, 0.45, 0.8, 2.0])
def test_sampled_a2_is_the_sho_kernel_of_tinygp(zeta: float) -> None:
    omega_n, dt, n = 80.0, 1e-3, 120
    x = 0.01 * np.random.default_rng(3).normal(size=n).cumsum()
    # the shocks' standard deviation that makes the stationary one 1 cm
    sigma_a = 0.01 / jnp.sqrt(start_moments(*to_differences(omega_n, zeta, dt), 1.0)[0])
    ours = arma21_log_likelihood(x, *to_discrete(omega_n, zeta, dt), sigma_a, start="stationary")
    kernel = tinygp.kernels.quasisep.SHO(omega=omega_n, quality=1 / (2 * zeta), sigma=0.01)
    theirs = tinygp.GaussianProcess(kernel, dt * np.arange(n), diag=0.0).log_probability(x)
    # well sampled, the kernel's own factor loses (omega_n dt)^3 of its digits
    assert float(ours) == pytest.approx(float(theirs), rel=1e-6)


def test_series_have_the_moments_of_the_density() -> None:
    # under the true density each score has mean zero and a variance equal to the information
    truth, first = jnp.array([0.3, 0.08, -0.5, 0.2]), jnp.array([0.0, 0.5])
    shocks = truth[3] * jax.random.normal(jax.random.key(0), (59, 4000))
    series = arma21_series(first, shocks, *truth[:3])
    assert (series[:, :2] == first).all()

    def value(p: jax.Array, x: jax.Array) -> jax.Array:
        return by_differences(x, *p)

    scores = jax.jit(jax.vmap(jax.grad(value), (None, 0)))(truth, series)
    z = scores.mean(0) / (scores.std(0) / np.sqrt(len(series)))
    # four standard normal numbers: beyond 4 once in 4000 times
    assert np.abs(z).max() < 4


def test_no_stationary_distribution_has_no_density() -> None:
    assert float(arma21_log_likelihood(walk(), 2.1, -1.05, 0.0, 1.0, start="stationary")) == -np.inf


def test_parameters_and_series_broadcast() -> None:
    x = np.stack([walk(40, 1), walk(40, 2)])
    values = arma21_log_likelihood(x[:, None], 1.9, -0.92, np.array([-0.5, 0.0, 0.5]), 0.3)
    assert values.shape == (2, 3)
    assert float(values[1, 2]) == pytest.approx(float(arma21_log_likelihood(x[1], 1.9, -0.92, 0.5, 0.3)))


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="three samples"):
        arma21_log_likelihood([1.0, 2.0], 1.0, 0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="stationary"):
        arma21_log_likelihood([1.0, 2.0, 3.0], 1.0, 0.0, 0.0, 1.0, start="frozen")
    with pytest.raises(ValueError, match="3 to 4 samples"):
        sine_transforms(np.zeros((2, 4)), np.array([4, 2]))
