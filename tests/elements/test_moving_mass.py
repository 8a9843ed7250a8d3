"""A mass between impactor and spring against closed forms."""

from __future__ import annotations

import numpy as np
from element_values import MASS, VALUES, VELOCITY

from bayestissue.mechanics.elements import impact, outcomes

K, C, ADDED = VALUES["moving_mass"].values()


def test_momentum_is_shared_at_contact_and_energy_lost() -> None:
    found = outcomes("moving_mass", VALUES["moving_mass"] | {"C": 1e-9}, MASS, VELOCITY)
    share = MASS / (MASS + ADDED)
    # Nothing but the blow takes energy, and the tissue moves on with its part where the impactor leaves.
    np.testing.assert_allclose(found["restitution"], share, rtol=1e-7)
    np.testing.assert_allclose(found["peak_depth"], VELOCITY * share * np.sqrt((MASS + ADDED) / K), rtol=1e-7)
    np.testing.assert_allclose(found["time_to_peak"], np.pi / 2 * np.sqrt((MASS + ADDED) / K), rtol=1e-7)


def test_a_recording_read_without_it_shows_k_and_c_too_small_by_the_share() -> None:
    """At V M / (M + m), with K and C smaller by M / (M + m), spring and damper alone move as this does."""
    time = np.tile(np.linspace(0.0, 0.02, 51), (3, 1))
    made = impact("moving_mass", VALUES["moving_mass"], MASS, VELOCITY, time)
    share = MASS / (MASS + ADDED)
    alike = impact("kelvin_voigt", {"K": K * share, "C": C * share}, MASS, VELOCITY * share, time)
    np.testing.assert_allclose(made.deceleration, alike.deceleration, rtol=1e-9, atol=1e-9)
