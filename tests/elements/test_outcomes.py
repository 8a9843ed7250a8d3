from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from element_values import MASS, NAMES, VALUES, VELOCITY, after_contact, solved
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from bayestissue.base.outcome_table import OUTCOMES
from bayestissue.mechanics.elements import element, outcomes
from bayestissue.mechanics.elements.element import Collision
from bayestissue.mechanics.elements.head_injury import LONGEST
from bayestissue.mechanics.elements.outcomes import _of_path, outcomes_of
from bayestissue.mechanics.elements.whole_impact import LONG, NODES, Path


def test_closed_forms_of_spring_and_damper_are_the_solved_path() -> None:
    """From hardly damped to far past critical damping, through the two places where the formulas turn."""
    zeta = np.array([1e-3, 0.05, 0.2, 0.45, 0.5, 0.55, 0.8, 0.999, 1.0, 1.001, 1.5, 3.0])
    mass, K, V = (np.full(zeta.shape, value) for value in (0.8, 3000.0, 1.5))
    which, p = element("kelvin_voigt"), {"K": jnp.asarray(K), "C": jnp.asarray(2 * zeta * np.sqrt(mass * K))}
    collision = Collision(which, p, jnp.asarray(mass), jnp.asarray(V))
    path = jax.jit(lambda collision: _of_path(Path.solved(collision)))(collision)
    closed = outcomes_of(collision)
    for name in path:
        if name in LONGEST:
            continue
        # Of a path: the parabola through places 1/8 of a step apart is off by its third derivative.
        tolerance = 0.1 * (LONG / (NODES - 1) / 8) ** 3 if name in ("peak_force", "peak_jerk") else 1e-10
        assert_allclose(closed[name], path[name], rtol=tolerance, err_msg=name)


def greatest(values: np.ndarray) -> float:
    """Of the parabola through the greatest of values at even times and its neighbours; at an end that."""
    k = int(values.argmax())
    if k in (0, len(values) - 1):
        return float(values[k])
    before, here, after = values[k - 1 : k + 2]
    return float(here + (after - before) ** 2 / (8 * (2 * here - before - after)))


def zero_of(values: np.ndarray, k: int) -> tuple[int, float]:
    """Where values fall to 0 between k and the time after it: along the chord."""
    return k, values[k] / (values[k] - values[k + 1])


def head_injury_of_all_windows(time: np.ndarray, left: np.ndarray, longest: float) -> float:
    """Of every pair of times at most so far apart: the velocity that the force takes, over their distance."""
    taken, length = (np.subtract.outer(*pair).T for pair in ((left, left), (-time, -time)))
    fits = (length > 0) & (length <= longest * (1 + 1e-9))
    return float(((taken[fits] / 9.80665) ** 5 / length[fits] ** 3).max() ** 0.5)


def test_head_injury_criterion_of_a_half_sine() -> None:
    """Of A sin(pi t / T) the window is about the middle (Chou and Nyquist 1974): 0.4146 A^2.5 T, or less."""
    omega_n, V = np.pi / np.array([0.008, 0.02, 0.05]), np.array([3.0, 4.0, 2.0])
    mass = np.full(3, 4.6)
    ours = outcomes("kelvin_voigt", {"K": mass * omega_n**2, "C": 1e-9}, mass, V, headform=True)
    peak, duration = omega_n * V / 9.80665, np.pi / omega_n
    # The best half width, as an angle: tan u = 5 u / 3.
    best = brentq(lambda u: np.tan(u) - 5 * u / 3, 0.5, 1.5)
    for name, longest in LONGEST.items():
        u = np.minimum(best, omega_n * longest / 2)
        true = peak**2.5 * duration * 2 * u / np.pi * (np.sin(u) / u) ** 2.5
        assert_allclose(ours[name], true, rtol=1e-6)
        assert_allclose(true[0], 0.4146 * peak[0] ** 2.5 * duration[0], rtol=1.3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_head_injury_criterion_is_that_of_all_windows(name: str) -> None:
    gravity = 9.80665
    ours = outcomes(name, VALUES[name], MASS, VELOCITY, gravity=gravity, headform=True)
    for row in range(len(MASS)):
        leaves = float(ours["contact_duration"][row])
        # Of one that is never left until it has come to rest; both bounds are whole numbers of steps.
        end, step = leaves if np.isfinite(leaves) else 6 * float(ours["time_to_peak"][row]), 3e-5
        time = np.arange(0, end, step)
        _, v, *_ = solved(name, row, time, gravity)
        for criterion, longest in LONGEST.items():
            true = head_injury_of_all_windows(time, v - gravity * time, longest)
            # Each moment is at most half a step off: of a half sine 3 squares of step over contact.
            tolerance = 10 * (step / (2 * float(ours["time_to_peak"][row]))) ** 2
            assert_allclose(ours[criterion][row], true, rtol=tolerance, err_msg=criterion)


@pytest.mark.slow
@pytest.mark.parametrize("gravity", [0.0, 9.80665])
@pytest.mark.parametrize("name", NAMES)
def test_outcomes_are_those_of_an_independent_integration(name: str, gravity: float) -> None:
    ours = outcomes(name, VALUES[name], MASS, VELOCITY, gravity=gravity or None)
    for row, (M, V) in enumerate(zip(MASS, VELOCITY, strict=True)):
        leaves = float(ours["contact_duration"][row])
        if not np.isfinite(leaves):
            continue
        time = np.linspace(0, 1.01 * leaves, 20_001)
        x, v, a, _ = solved(name, row, time, gravity)
        # The first fall of the force to 0 after contact. A Hertz force has no slope where it ends: that is
        # where the impactor is back at the surface.
        after = int(np.argmax((a[1:] <= 0) & (time[1:] > leaves / 2)))
        k, share = zero_of(a if a[after + 1] < 0 else x, after)
        end, last, depth = (values[k] + share * (values[k + 1] - values[k]) for values in (time, v, x))
        deepest, of_step = zero_of(v, int(np.argmax(v[1:] <= 0)))
        contact = slice(0, k + 1)
        jerk = np.abs(np.gradient(a[contact], time[contact], edge_order=2))
        # The blow at contact, in which a moving mass is taken along.
        begins = after_contact(name)[row]
        work = M * (V**2 - begins**2) / 2
        work += M * np.trapezoid(np.append(a[contact], 0.0), np.append(x[contact], depth))
        came, fell = M * V**2 / 2, M * gravity * depth
        true = {
            "peak_force": M * greatest(a[contact]),
            "peak_deceleration": greatest(a[contact]) / 9.80665,
            "peak_depth": greatest(x[contact]),
            "time_to_peak": time[deepest] + of_step * time[1],
            "contact_duration": end,
            "rebound_velocity": -last,
            "restitution": -last / V,
            "impulse": M * (V - begins)
            + M * np.trapezoid(np.append(a[contact], 0.0), np.append(time[contact], end)),
            "peak_jerk": greatest(jerk),
            "energy_absorbed": work,
            "energy_share": work / came,
            "energy_share_with_gravity": work / (came + fell),
        }
        assert set(true) == set(OUTCOMES)
        true["energy_lost"] = 1 - (last / V) ** 2
        for outcome, value in true.items():
            # Of the velocity at contact, beside which that of leaving may be small.
            tolerance = 1e-6 * max(1.0, V / -last)
            assert_allclose(ours[outcome][row], value, rtol=tolerance, err_msg=outcome)


@pytest.mark.slow
def test_who_never_leaves_has_no_rebound() -> None:
    """The first comes to rest on its spring. Under the second the damper yields for ever, by M g / C."""
    M, V, g = 1.2, 1.0, 9.80665
    for name, K, C in (("kelvin_voigt", 2000.0, 150.0), ("maxwell", 3000.0, 50.0)):
        ours = outcomes(name, {"K": K, "C": C}, M, V, gravity=g)
        assert np.isinf(ours["contact_duration"])
        assert_allclose([ours["rebound_velocity"], ours["restitution"]], 0.0)
        # All that came in was taken, and nothing else.
        assert_allclose([ours["energy_lost"], ours["energy_share_with_gravity"]], 1.0)


def test_the_depth_on_what_yields_for_ever_is_that_of_the_first_standstill() -> None:
    M, V, g, K, C = 1.2, 1.0, 9.80665, 3000.0, 80.0

    def field(t: float, y: np.ndarray) -> list[float]:
        return [y[1], g - y[2] / M, K * (y[1] - y[2] / C)]

    def stands(t: float, y: np.ndarray) -> float:
        return float(y[1])

    stands.direction = -1  # type: ignore[attr-defined]
    whole = solve_ivp(field, (0, 1), [0.0, V, 0.0], "DOP853", events=stands, rtol=1e-12, atol=1e-14)
    ours = outcomes("maxwell", {"K": K, "C": C}, M, V, gravity=g)
    assert np.isinf(ours["contact_duration"])
    assert whole.y[0].max() > 1.5 * ours["peak_depth"]
    assert_allclose(ours["peak_depth"], whole.y_events[0][0][0], rtol=1e-9)
