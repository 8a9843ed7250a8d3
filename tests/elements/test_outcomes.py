from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from element_values import MASS, NAMES, VALUES, VELOCITY, solved
from numpy.testing import assert_allclose

from bayestissue.elements import element, impact, outcomes
from bayestissue.elements.outcomes import OUTCOMES, _solved, outcomes_of
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
    assert_allclose(found.peak_force, force.max(axis=1), rtol=1e-9)
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


def test_closed_forms_of_spring_and_damper_are_the_solved_path() -> None:
    """From hardly damped to far past critical damping, through the two places where the formulas turn."""
    zeta = np.array([1e-3, 0.05, 0.2, 0.45, 0.5, 0.55, 0.8, 0.999, 1.0, 1.001, 1.5, 3.0])
    mass, K, V = (np.full(zeta.shape, value) for value in (0.8, 3000.0, 1.5))
    which, p = element("kelvin_voigt"), {"K": jnp.asarray(K), "C": jnp.asarray(2 * zeta * np.sqrt(mass * K))}
    closed, path = outcomes_of(which, p, mass, V), _solved(which, p, mass, V)
    for name in closed._fields:
        # Of a path: the parabola through the greatest of places a thousandth of a contact apart.
        tolerance = 1e-8 if name == "peak_force" else 1e-10
        assert_allclose(getattr(closed, name), getattr(path, name), rtol=tolerance, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("gravity", [0.0, 9.80665])
@pytest.mark.parametrize("name", NAMES)
def test_outcomes_are_those_of_an_independent_integration(name: str, gravity: float) -> None:
    ours = outcomes(name, VALUES[name], MASS, VELOCITY, gravity=gravity or None)
    for row, (M, V) in enumerate(zip(MASS, VELOCITY, strict=True)):
        leaves = float(ours.contact_duration[row])
        if not np.isfinite(leaves):
            continue
        time = np.linspace(0, 1.02 * leaves, 8001)
        x, v, a, _ = solved(name, row, time, gravity)
        # The first fall of the force to 0 after contact, along the chord between two times.
        after = int(np.argmax((a[1:] <= 0) & (time[1:] > leaves / 2))) + 1
        # A Hertz force has no slope where it ends: that is where the impactor is back at the surface.
        falls = a if a[after] < 0 else x
        share = falls[after - 1] / (falls[after - 1] - falls[after])
        end, last = (values[after - 1] + share * (values[after] - values[after - 1]) for values in (time, v))
        until = time <= end
        work = M * np.trapezoid(a[until], x[until])
        true = {
            "peak_force": M * a[until].max(),
            "peak_deceleration": a[until].max() / 9.80665,
            "peak_depth": x[until].max(),
            "time_to_peak": time[x[until].argmax()],
            "contact_duration": end,
            "rebound_velocity": -last,
            "restitution": -last / V,
            "energy_absorbed": work,
        }
        assert set(true) == set(OUTCOMES)
        for outcome, value in true.items():
            # The greatest depth on the grid is at most half a step away; of the rest squares of steps.
            step = time[1] / value if outcome == "time_to_peak" else 0.0
            tolerance = max(1e-5 * max(1.0, V / -last), step / 2)
            assert_allclose(getattr(ours, outcome)[row], value, rtol=tolerance, err_msg=outcome)
