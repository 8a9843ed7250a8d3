from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from bayestissue.oscillator import (
    autocovariance_a2,
    autocovariance_arma21,
    green_a2,
    green_arma21,
    green_arma21_implicit,
    to_discrete,
)

ZETAS = [0.02, 0.4, 0.9999, 1.0, 1.0001, 1.7, 4.0]


@pytest.mark.parametrize("zeta", ZETAS)
def test_explicit_and_implicit_green_functions_agree(zeta: float) -> None:
    phi1, phi2, theta1 = to_discrete(0.3, zeta, 1.0)
    implicit = green_arma21_implicit(phi1, phi2, theta1, 80)
    np.testing.assert_allclose(green_arma21(np.arange(80), phi1, phi2, theta1), implicit, atol=1e-11)


def test_explicit_green_function_is_equation_9() -> None:
    phi1, phi2, theta1 = 1.2, -0.7, -0.3
    roots = np.roots([1, -phi1, -phi2])
    g = (roots - theta1) / (roots - roots[::-1])
    j = np.arange(30)
    np.testing.assert_allclose(
        green_arma21(j, phi1, phi2, theta1), (g @ roots[:, None] ** j).real, atol=1e-13
    )


@pytest.mark.parametrize("zeta", [0.4, 1.0, 1.7])
def test_autocovariance_of_the_a2_is_the_integral_of_its_green_function(zeta: float) -> None:
    omega_n, lag = 3.0, 0.4

    product = jax.jit(lambda t: green_a2(t, omega_n, zeta) * green_a2(t + lag, omega_n, zeta))
    end = 12 / (omega_n * min(zeta, 1 / (2 * zeta)))
    integral = quad(lambda t: float(product(t)), 0, end, epsabs=1e-11, limit=400)[0]
    assert float(autocovariance_a2(lag, omega_n, zeta)) == pytest.approx(integral, abs=1e-8)


@pytest.mark.parametrize("zeta", [0.05, *ZETAS[1:]])
def test_autocovariance_of_the_arma21_is_the_sum_over_its_green_function(zeta: float) -> None:
    phi1, phi2, theta1 = to_discrete(0.5, zeta, 1.0)
    green = np.asarray(green_arma21_implicit(phi1, phi2, theta1, 4000))
    sums = [float(green[: 4000 - k] @ green[k:]) for k in range(6)]
    np.testing.assert_allclose(
        autocovariance_arma21(jnp.arange(6), phi1, phi2, theta1), sums, rtol=1e-9, atol=1e-10
    )


@pytest.mark.parametrize("zeta", [0.05, *ZETAS[1:]])
def test_both_processes_have_the_same_autocorrelation_at_the_samples(zeta: float) -> None:
    lags = jnp.arange(12)
    discrete = autocovariance_arma21(lags, *to_discrete(0.5, zeta, 1.0))
    continuous = autocovariance_a2(lags, 0.5, zeta)
    np.testing.assert_allclose(discrete / discrete[0], continuous / continuous[0], atol=1e-11)
