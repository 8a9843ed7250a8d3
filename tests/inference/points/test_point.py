from __future__ import annotations

import jax
import numpy as np
import pytest

from bayestissue.inference.points.point_fit import fit_points
from bayestissue.mechanics.oscillator import (
    impact_motion,
    spring_damper_inverse,
    time_to_peak,
)

K, C, DT, VELOCITY = 3000.0, 25.0, 1e-4, 1.5
# The slowest and the fastest recorder by default, each of a width of its own to compile; all in the long one.
RATES = [2e3, pytest.param(1e4, marks=pytest.mark.long), 5e4]
motion = jax.jit(impact_motion)


def trace(
    K: np.ndarray, C: np.ndarray, mass: np.ndarray, rate: float, gravity: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Noise-free displacements from contact to the peak, padded, and their lengths."""
    omega_n, zeta = (np.asarray(p) for p in spring_damper_inverse(K, C, mass))
    n = np.floor(np.asarray(time_to_peak(omega_n, zeta, VELOCITY, gravity)) * rate).astype(int) + 1
    time = np.arange(n.max()) / rate
    return np.asarray(motion(time, omega_n[:, None], zeta[:, None], VELOCITY, gravity).displacement), n


@pytest.mark.slow
@pytest.mark.parametrize("rate", RATES)
def test_noise_free_impacts_give_back_stiffness_and_damping(rate: float) -> None:
    mass, zeta = (a.ravel() for a in np.meshgrid([0.1, 0.375, 1.0, 5.0], [0.02, 0.1, 0.5, 1.0, 1.5, 2.0]))
    damping = 2 * zeta * np.sqrt(K * mass)
    x, n = trace(np.full(24, K), damping, mass, rate)
    fit = fit_points(x, n, np.full(24, 1 / rate), mass)
    # the samples satisfy the recursion to 1e-16 of x; x'' is (omega dt)^2 > 1e-7 of it
    np.testing.assert_allclose(fit.K, K, rtol=1e-8)
    np.testing.assert_allclose(fit.C, damping, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("rate", RATES[:2])
def test_noise_free_drops_give_back_stiffness_and_damping(rate: float) -> None:
    mass, zeta = (a.ravel() for a in np.meshgrid([0.1, 0.375, 1.0, 5.0], [0.02, 0.1, 0.3, 0.5, 1.0, 1.5]))
    damping = 2 * zeta * np.sqrt(K * mass)
    x, n = trace(np.full(24, K), damping, mass, rate, 9.80665)
    given = (x, n, np.full(24, 1 / rate), mass)
    fit, without = fit_points(*given, gravity=np.full(24, 9.80665)), fit_points(*given)
    # What gravity adds to the second differences is taken for the same of all tissues.
    for of_gravity, of_none, true in ((fit.K, without.K, K), (fit.C, without.C, damping)):
        assert (np.abs(of_gravity / true - 1) < np.abs(of_none / true - 1)).all()
    assert (np.abs(without.K / K - 1) > 0.01).all()


@pytest.mark.slow
def test_conditional_fit_is_the_least_sum_of_squares() -> None:
    (x,), _ = trace(np.array([K]), np.array([C]), np.array([0.666]), 1 / DT)
    # Smooth noise, as the recursion's own would be.
    x = x + 1e-5 * np.cumsum(np.random.default_rng(1).standard_normal(len(x)))
    fit = fit_points(x[None] - x.mean(), np.array([len(x)]), np.array([DT]), np.array([0.666]))

    def squares(p: np.ndarray) -> float:
        centred, total, shock = x - x.mean(), 0.0, 0.0
        for t in range(2, len(x)):
            shock = centred[t] - p[0] * centred[t - 1] - p[1] * centred[t - 2] + p[2] * shock
            total += shock**2
        return total

    at = np.array([fit.phi1[0], fit.phi2[0], fit.theta1[0]])
    assert squares(at) == pytest.approx(fit.sigma_a[0] ** 2 * (len(x) - 2), rel=1e-9)
    for step in 1e-4 * np.eye(3):
        assert squares(at) <= min(squares(at + step), squares(at - step)) * (1 + 1e-9)


def test_no_impacts_and_no_motion_are_no_reason_to_fail() -> None:
    none = fit_points(np.empty((0, 20)), np.empty(0, int), np.empty(0), np.empty(0))
    assert none.K.shape == (0,)
    still = fit_points(np.zeros((2, 20)), np.array([20, 12]), np.full(2, DT), np.ones(2))
    assert np.isnan(still.K).all()
