from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayestissue.elements import element, impact
from bayestissue.elements.outcomes import outcomes_of
from bayestissue.oscillator.impact import impact_motion, peak_displacement, time_to_peak

M, V = jnp.array([0.4, 0.8, 1.3, 0.5]), jnp.array([1.0, 1.5, 2.0, 0.7])
K, C = jnp.array([2500.0, 4000.0, 1500.0, 800.0]), jnp.array([5.0, 30.0, 100.0, 60.0])


@pytest.mark.slow
def test_peaks_of_spring_and_damper_are_those_of_the_formulas() -> None:
    p = {"K": K, "C": C, "diameter_m": jnp.full(4, 0.03)}
    found = outcomes_of(element("kelvin_voigt"), p, M, V)
    omega_n, zeta = jnp.sqrt(K / M), C / (2 * jnp.sqrt(K * M))
    assert_allclose(found.time_to_peak, time_to_peak(omega_n, zeta), rtol=1e-9)
    assert_allclose(found.peak_depth, peak_displacement(omega_n, zeta, V), rtol=1e-9)
    time = np.linspace(0, 1, 200_001) * np.asarray(found.time_to_peak)[:, None]
    force = M[:, None] * impact_motion(time, omega_n[:, None], zeta[:, None], V[:, None]).deceleration
    assert_allclose(found.peak_force, force.max(axis=1), rtol=2e-6)
    # Of a strong damper the force is greatest at contact.
    assert_allclose(found.peak_force[2], C[2] * V[2], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hunt_crossley", pytest.param("maxwell", marks=pytest.mark.long)])
def test_peaks_are_those_of_the_simulated_path(name: str) -> None:
    which = element(name)
    extra = {each.name: jnp.full(2, each.typical) for each in which.extra}
    own = (
        {"K": jnp.array([3e5, 2e5]), "C": jnp.array([3e5, 1e5])}
        if name == "hunt_crossley"
        else {"K": K[:2], "C": C[:2] * 5}
    )
    found = outcomes_of(which, {**own, **extra, "diameter_m": jnp.full(2, 0.0318)}, M[:2], V[:2])
    time = np.linspace(0, 2, 4001) * np.asarray(found.time_to_peak)[:, None]
    path = impact(which, {**own, **extra}, M[:2], V[:2], time)
    assert_allclose(found.peak_depth, path.x.max(axis=1), rtol=1e-5)
    assert_allclose(found.peak_force, (M[:2, None] * path.deceleration).max(axis=1), rtol=1e-5)
