from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.mechanics.oscillator import impact_motion
from bayestissue.model.likelihood.element.spring_damper import response, response_in_blocks

# Undamped, lightly damped, both sides of critical damping and at it, and far above it.
ZETA = np.array([0.0, 0.3, 1 - 1e-9, 1.0, 1.01, 3.0])
OMEGA_N = np.array([60.0, 120.0, 80.0, 100.0, 90.0, 70.0])
FIRST, DT = np.array([0.0, 1e-4, 5e-4, 0.0, 2e-4, 1e-3]), np.array([2e-4, 1e-4, 5e-4, 2e-4, 1e-4, 2e-4])


@pytest.mark.slow
def test_a_grid_is_its_times_one_by_one() -> None:
    lanes = 24
    grid = response_in_blocks(*map(jnp.asarray, (FIRST, DT, OMEGA_N, ZETA)), lanes)
    time = FIRST[:, None] + np.arange(8 * lanes) * DT[:, None]
    single = response(jnp.asarray(time), jnp.asarray(OMEGA_N[:, None]), jnp.asarray(ZETA[:, None]))
    for name, part, direct in zip(grid._fields, grid, single, strict=True):
        assert part.shape == (8, 6, lanes)
        rows = np.asarray(part).swapaxes(0, 1).reshape(6, -1)
        # Rounding in units of the greatest value: products cancel where the motion passes zero.
        error = np.abs(rows - direct).max(1) / np.abs(direct).max(1)
        assert (error < 1e-13).all(), name


def test_the_response_is_the_motion_at_unit_velocity() -> None:
    time = jnp.asarray(np.linspace(0, 0.05, 40))
    made = response(time, jnp.asarray(OMEGA_N[:, None]), jnp.asarray(ZETA[:, None]))
    motion = impact_motion(time, OMEGA_N[:, None], ZETA[:, None], 1.0)
    assert_allclose(made.x, motion.displacement, rtol=1e-13, atol=1e-18)
    assert_allclose(made.v, motion.velocity, rtol=1e-12, atol=1e-14)
