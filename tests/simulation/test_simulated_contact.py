from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from bayestissue.elements import element_names
from bayestissue.simulation import Simulation, simulate

pytestmark = pytest.mark.slow

CONDITIONS = [
    {"trial": "a", "mass_kg": 0.5, "velocity_m_s": 1.5, "diameter_m": 0.0254},
    {"trial": "b", "mass_kg": 0.5, "velocity_m_s": 1.5, "diameter_m": 0.0381},
]


def campaign(**tissue: object) -> Simulation:
    return Simulation.model_validate(
        {
            "name": "one tissue",
            "design": {"subjects": 1, "conditions": CONDITIONS},
            "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 60.0, **tissue},
        }
    )


def test_a_larger_ball_meets_more_of_a_half_space() -> None:
    made = simulate(campaign(element="hunt_crossley"))
    assert made.impacts["diameter_m"].tolist() == [0.0254, 0.0381]
    small, large = made.truth["peak_displacement_m"]
    # Without damping the depth goes with k^(-2/5), k with the root of the diameter: 0.922 in depth.
    np.testing.assert_allclose(large / small, 1.5**-0.2, rtol=0.02)


def test_momentum_is_that_of_the_force() -> None:
    """The recorded deceleration sums to the velocity that the impactor loses."""
    made = simulate(campaign(element="wall", parameters={"thickness_m": 0.03}))
    value = np.split(made.value, np.cumsum(made.n_samples)[:-1])
    lost = np.array([each.sum() for each in value]) / 10_000
    leaving = made.truth["velocity_m_s"] * (1 + np.sqrt(1 - made.truth["energy_lost"]))
    # The jump at contact, of 180 m/s^2, falls between samples: up to half of it over 0.1 ms.
    np.testing.assert_allclose(lost, leaving, atol=0.5 * 180e-4)


def test_parameters_must_be_the_elements_own() -> None:
    with pytest.raises(ValidationError, match="parameters with the keys arm_ratio"):
        campaign(element="standard_linear")
    with pytest.raises(ValidationError, match=f"an element of {', '.join(element_names())}"):
        campaign(element="jelly")


def test_a_mass_that_creeps_for_ever_is_recorded_until_its_speed_is_gone() -> None:
    """Spring and damper in series, C below (K M)^1/2 / 2: the speed only fades."""
    made = simulate(campaign(element="maxwell", C_N_s_per_m=10.0))
    assert np.isinf(made.truth["time_to_peak_s"]).all()
    value = np.split(made.value, np.cumsum(made.n_samples)[:-1])
    # The jump of the jerk at contact falls between samples.
    np.testing.assert_allclose([each.sum() / 10_000 for each in value], 1.5, rtol=1e-3)
