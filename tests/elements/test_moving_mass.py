"""A mass between impactor and spring against the system of two degrees of freedom that it is the limit of."""

from __future__ import annotations

import numpy as np
import pytest
from element_values import MASS, VALUES, VELOCITY
from scipy.integrate import solve_ivp

from bayestissue.mechanics.elements import impact, outcomes

K, C, ADDED = VALUES["moving_mass"].values()


def two_masses(row: int, time: np.ndarray, settles: float) -> np.ndarray:
    """x and x' of the impactor, x_m and x_m' of the tissue: their contact is a spring beside a damper.

    The contact pushes and never pulls. ``settles`` is the time constant of its damper [s]; the spring, damped
    ten times more than critically, is soft enough to leave the blow without restitution.
    """
    M, together = MASS[row], MASS[row] * ADDED / (MASS[row] + ADDED)
    damping = together / settles
    spring = damping**2 / (4 * together) / 100

    def field(t: float, y: np.ndarray) -> list[float]:
        x, v, at, w = y
        push = max(spring * (x - at) + damping * (v - w), 0.0)
        return [v, -push / M, w, (push - K * at - C * w) / ADDED]

    start = [0.0, VELOCITY[row], 0.0, 0.0]
    return solve_ivp(field, (0, time[-1]), start, "Radau", time, rtol=1e-9, atol=1e-12).y


@pytest.mark.slow
def test_it_is_the_limit_of_a_stiff_contact_that_swallows_the_blow() -> None:
    """The difference is of first order in how long the contact takes to settle."""
    time = np.linspace(0.0, 0.02, 101)
    made = impact("moving_mass", VALUES["moving_mass"], MASS, VELOCITY, np.tile(time, (3, 1)))
    late = time > 0.005
    for row in range(len(MASS)):
        pushes = late & (time < 0.95 * float(made.leaves[row]))
        off = []
        for settles in (4e-5, 1e-5):
            x, v, *_ = two_masses(row, time, settles)
            off += [np.abs(np.asarray(made.v)[row] - v)[pushes].max() / VELOCITY[row]]
            assert np.abs(np.asarray(made.x)[row] - x)[pushes].max() < 2 * settles * VELOCITY[row]
        assert off[1] < 0.3 * off[0] < 0.3 * 0.02


def test_momentum_is_shared_at_contact_and_energy_lost() -> None:
    found = outcomes("moving_mass", VALUES["moving_mass"] | {"C": 1e-9}, MASS, VELOCITY)
    share = MASS / (MASS + ADDED)
    # Nothing but the blow takes energy, and the tissue moves on with its part where the impactor leaves.
    np.testing.assert_allclose(found.restitution, share, rtol=1e-7)
    np.testing.assert_allclose(found.peak_depth, VELOCITY * share * np.sqrt((MASS + ADDED) / K), rtol=1e-7)
    np.testing.assert_allclose(found.time_to_peak, np.pi / 2 * np.sqrt((MASS + ADDED) / K), rtol=1e-7)


def test_a_recording_read_without_it_shows_k_and_c_too_small_by_the_share() -> None:
    """At V M / (M + m), with K and C smaller by M / (M + m), spring and damper alone move as this does."""
    time = np.tile(np.linspace(0.0, 0.02, 51), (3, 1))
    made = impact("moving_mass", VALUES["moving_mass"], MASS, VELOCITY, time)
    share = MASS / (MASS + ADDED)
    alike = impact("kelvin_voigt", {"K": K * share, "C": C * share}, MASS, VELOCITY * share, time)
    np.testing.assert_allclose(made.deceleration, alike.deceleration, rtol=1e-9, atol=1e-9)
