from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from bayestissue.inference.quantities.whole import integrals
from bayestissue.model.likelihood.noise import discrepancy_modes

COUNT = np.array([38, 45])


def test_modes_of_the_shortest_and_of_a_long_trace_are_orthonormal() -> None:
    basis, share = (
        np.asarray(part) for part in discrepancy_modes(np.array([8, 3000]), np.tile(np.arange(3000), (2, 1)))
    )
    np.testing.assert_allclose(basis @ basis.swapaxes(1, 2), [np.eye(6)] * 2, atol=1e-10)
    assert (share > 0).all()


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
