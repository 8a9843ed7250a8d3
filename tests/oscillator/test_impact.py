from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from bayestissue.mechanics.oscillator import (
    impact_motion,
    peak_displacement,
    spring_damper,
    spring_damper_inverse,
    time_to_peak,
)

ZETAS = [0.0, 0.4, 0.9999, 1.0, 1.7, 10.0]


@settings(deadline=None)
@given(st.floats(1e-3, 1e7), st.floats(1e-6, 1e4), st.floats(1e-3, 1e3))
def test_spring_and_damper_make_a_round_trip(K: float, C: float, mass: float) -> None:
    back = spring_damper(*spring_damper_inverse(K, C, mass), mass)
    np.testing.assert_allclose(back, (K, C), rtol=1e-14)


@pytest.mark.parametrize("gravity", [0.0, 9.80665])
@pytest.mark.parametrize("zeta", ZETAS)
def test_motion_solves_the_equation_of_motion(zeta: float, gravity: float) -> None:
    omega_n, velocity, end = 60.0, 1.5, 0.05
    times = np.linspace(0, end, 40)
    solved = solve_ivp(
        lambda _, y: [y[1], gravity - 2 * zeta * omega_n * y[1] - omega_n**2 * y[0]],
        (0, end),
        [0.0, velocity],
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        t_eval=times,
    )
    motion = impact_motion(times, omega_n, zeta, velocity, gravity)
    np.testing.assert_allclose(motion.displacement, solved.y[0], atol=1e-11)
    np.testing.assert_allclose(motion.velocity, solved.y[1], atol=1e-9)
    # What a sensor reads that is 0 in free fall: the force over the mass.
    force = 2 * zeta * omega_n * solved.y[1] + omega_n**2 * solved.y[0]
    np.testing.assert_allclose(motion.deceleration, force, atol=1e-7)


@pytest.mark.parametrize("gravity", [0.0, 9.80665])
@pytest.mark.parametrize("zeta", [zeta for zeta in ZETAS if zeta < 10])
def test_velocity_is_zero_and_displacement_greatest_at_the_peak(zeta: float, gravity: float) -> None:
    peak = time_to_peak(60.0, zeta, 1.5, gravity)
    motion = impact_motion(peak, 60.0, zeta, 1.5, gravity)
    assert float(motion.velocity) == pytest.approx(0.0, abs=1e-13)
    deepest = float(peak_displacement(60.0, zeta, 1.5, gravity))
    assert float(motion.displacement) == pytest.approx(deepest, rel=1e-13)
    assert (impact_motion(peak * np.linspace(0, 0.99, 50), 60.0, zeta, 1.5, gravity).velocity > 0).all()


def test_strong_damping_lets_a_slow_drop_sink_without_a_peak() -> None:
    # V is below x_e times the fast decay: the velocity stays above 0.
    assert np.isinf(time_to_peak(60.0, 10.0, 1.5, 9.80665))
    assert float(peak_displacement(60.0, 10.0, 1.5, 9.80665)) == pytest.approx(9.80665 / 60.0**2, rel=1e-15)
    motion = impact_motion(np.linspace(0, 20, 500), 60.0, 10.0, 1.5, 9.80665)
    assert (motion.velocity > -1e-12).all()
    assert float(motion.displacement[-1]) == pytest.approx(9.80665 / 60.0**2, rel=1e-9)


def test_peak_is_smooth_at_critical_damping() -> None:
    value, slope = jax.jit(jax.value_and_grad(lambda zeta: time_to_peak(1.0, zeta)))(jnp.array(1.0))
    # arccos(z)/sqrt(1-z^2) = 1 - (z-1)/3 + ...
    assert float(value) == pytest.approx(1.0, rel=1e-15)
    assert float(slope) == pytest.approx(-1 / 3, rel=1e-12)
