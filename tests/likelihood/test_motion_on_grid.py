from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.likelihood.element.spring_damper import response, response_in_blocks
from bayestissue.oscillator import impact_motion

# Undamped, lightly damped, both sides of critical damping and at it, and far above it.
ZETA = np.array([0.0, 0.3, 1 - 1e-9, 1.0, 1.01, 3.0])
OMEGA_N = np.array([60.0, 120.0, 80.0, 100.0, 90.0, 70.0])
FIRST, DT = np.array([0.0, 1e-4, 5e-4, 0.0, 2e-4, 1e-3]), np.array([2e-4, 1e-4, 5e-4, 2e-4, 1e-4, 2e-4])


def by_pq(time: jax.Array, p: jax.Array, q: jax.Array) -> jax.Array:
    omega_n = jnp.sqrt(q)
    return impact_motion(time, omega_n, p / (2 * omega_n), 1.0).displacement


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


@pytest.mark.slow
@pytest.mark.parametrize("k", range(len(ZETA)))
def test_w_is_the_slope_of_the_motion_by_q(k: int) -> None:
    time = jnp.asarray(np.linspace(0, 0.08, 50))
    p, q = jnp.asarray(2 * ZETA[k] * OMEGA_N[k]), jnp.asarray(OMEGA_N[k] ** 2)
    slope = jax.jacfwd(by_pq, argnums=2)(time, p, q)
    made = response(time, jnp.asarray(OMEGA_N[k]), jnp.asarray(ZETA[k]))
    # JAX differentiates the closed forms of x, which cancel as w's own does not.
    assert_allclose(made.w, -slope, rtol=1e-8, atol=1e-11 * np.abs(slope).max())


@pytest.mark.parametrize("k", range(len(ZETA)))
def test_w_is_the_motion_convolved_with_itself(k: int) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for t in (0.003, 0.02, 0.06):
        s = t / 2 * (nodes + 1)
        parts = [
            np.asarray(response(jnp.asarray(u), jnp.asarray(OMEGA_N[k]), jnp.asarray(ZETA[k])).x)
            for u in (s, t - s)
        ]
        direct = t / 2 * (weights * parts[0] * parts[1]).sum()
        made = response(jnp.asarray(t), jnp.asarray(OMEGA_N[k]), jnp.asarray(ZETA[k])).w
        # A smooth integrand by 60 nodes is right to rounding, of a sum that may cancel.
        assert float(made) == pytest.approx(direct, rel=1e-10, abs=1e-13 * t * np.abs(parts[0]).max() ** 2)
