from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import kernel
from recorded_impacts import two_impacts

from bayestissue.inference.quantities.whole import integrals
from bayestissue.model.likelihood.element.impact import MeasuredImpact
from bayestissue.model.likelihood.element.noise import discrepancy_modes

COUNT = np.array([38, 45])
LOG_S = (np.log(2.0), np.log(0.5))


def test_modes_are_those_of_the_kernel() -> None:
    basis, share = (
        np.asarray(part) for part in discrepancy_modes(COUNT, np.tile(np.arange(50), (len(COUNT), 1)))
    )
    assert basis.shape == (2, 6, 50)
    assert share.shape == (2, 6)
    for row, n in enumerate(COUNT):
        own = basis[row, :, :n]
        assert not basis[row, :, n:].any()
        np.testing.assert_allclose(own @ own.T, np.eye(6), atol=1e-11)
        np.testing.assert_allclose((own.T * share[row]) @ own, kernel(n), atol=1e-10)
        assert (np.diff(share[row]) < 0).all()
    np.testing.assert_allclose(share.sum(1), COUNT)


def test_modes_of_the_shortest_and_of_a_long_trace_are_orthonormal() -> None:
    basis, share = (
        np.asarray(part) for part in discrepancy_modes(np.array([8, 3000]), np.tile(np.arange(3000), (2, 1)))
    )
    np.testing.assert_allclose(basis @ basis.swapaxes(1, 2), [np.eye(6)] * 2, atol=1e-10)
    assert (share > 0).all()


@pytest.mark.slow
def test_no_amplitude_is_no_discrepancy() -> None:
    @jax.jit
    def density(measured: MeasuredImpact) -> jax.Array:
        return measured.log_density()

    given = two_impacts("kelvin_voigt", "stiffening", log_discrepancy=(-40.0, -40.0)).measured
    without = replace(given, noise_parameters=given.noise_parameters._replace(log_discrepancy=None))
    np.testing.assert_allclose(density(given), density(without), rtol=1e-12)


def test_the_amplitude_is_the_root_of_the_discrepancys_mean_square() -> None:
    given, number = two_impacts("kelvin_voigt", "stiffening", log_discrepancy=LOG_S).measured, 4000
    delta = np.asarray(given.discrepancy(given.prior_errors(jax.random.PRNGKey(0), (number,))))
    for row in range(2):
        mean_square = np.square(delta[:, row, : COUNT[row]]).mean()
        # Most of it is in two modes, so that a draw's mean square has a standard deviation of about its mean.
        assert abs(mean_square / np.exp(2 * LOG_S[row]) - 1) < 5 / np.sqrt(number)


def test_integrals_are_exact_for_a_constant_and_near_for_a_wave() -> None:
    dt, first = np.array([4e-4, 5e-4]), np.array([1e-4, 4e-4])
    time = first[:, None] + dt[:, None] * np.arange(COUNT.max())
    velocity, x = integrals(jnp.full(time.shape, 3.0), jnp.asarray(first), jnp.asarray(dt)[:, None])
    np.testing.assert_allclose(velocity, 3 * time, rtol=1e-12)
    # Trapezia of a straight line are exact.
    np.testing.assert_allclose(x, 3 * time**2 / 2, rtol=1e-12)
    rate = 100.0
    velocity, x = integrals(
        jnp.asarray(np.cos(rate * (time - first[:, None]))), jnp.asarray(first), jnp.asarray(dt)[:, None]
    )
    after = time - first[:, None]
    expected = first[:, None] + np.sin(rate * after) / rate
    # Of order (rate dt)^2 / 12, 2e-4, for each integration, relative to 1 / rate.
    np.testing.assert_allclose(velocity, expected, atol=3e-4 / rate)
