from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from bayestissue.mechanics.elements import element_names
from bayestissue.studies.simulation import Simulation, simulate

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


def test_the_truth_has_the_outcomes_that_the_recording_shows() -> None:
    """Of what an ideal recorder wrote down, by sums and greatest values in numpy."""
    content = campaign(element="stiffening", parameters={"stiffening_depth_m": 0.02}).model_dump(mode="json")
    content |= {"gravity": "drop", "headform": True}
    content["recording"] |= {"sampling_rate_hz": 100_000.0, "after_contact_s": 0.0}
    made = simulate(Simulation.model_validate(content))
    for row, d in zip(made.truth.to_dict("records"), [trace.value for trace in made.traces], strict=True):
        step, mass, G = 1e-5, row["mass_kg"], 9.80665
        d = d[d > 0]
        # Contact falls between samples: of the sums one sample of the greatest value is in doubt.
        taken = d.sum() * step
        leaving = taken - row["velocity_m_s"] - G * len(d) * step
        shown = {
            "peak_force_N": mass * d.max(),
            "peak_deceleration_g": d.max() / G,
            "contact_duration_s": len(d) * step,
            "rebound_velocity_m_s": leaving,
            "restitution": leaving / row["velocity_m_s"],
            "impulse_N_s": mass * taken,
            "peak_jerk_m_s3": np.abs(np.diff(d)).max() / step,
        }
        for name, value in shown.items():
            doubt = d.max() * step if name in ("rebound_velocity_m_s", "restitution", "impulse_N_s") else 0.0
            np.testing.assert_allclose(row[name], value, rtol=1e-3, atol=doubt, err_msg=name)
        absorbed = mass / 2 * row["velocity_m_s"] ** 2 * row["energy_share"]
        np.testing.assert_allclose(row["energy_absorbed_J"], absorbed)
        assert 0 < row["energy_share_with_gravity"] < row["energy_share"]
        # The window of full length that takes most, since contact is longer than both.
        for name, count in (("HIC15", 1500), ("HIC36", 3600)):
            most = np.convolve(d, np.ones(count), "valid").max() / count / G
            assert row[name] >= most**2.5 * count * step * (1 - 1e-3)
    assert made.dataset("headform").headform


def test_parameters_must_be_the_elements_own() -> None:
    with pytest.raises(ValidationError, match="parameters with the keys arm_ratio"):
        campaign(element="standard_linear")
    with pytest.raises(ValidationError, match=f"an element of {', '.join(element_names())}"):
        campaign(element="jelly")


def test_a_mass_that_creeps_for_ever_is_recorded_until_its_speed_is_gone() -> None:
    """Spring and damper in series, C below (K M)^1/2 / 2: the speed only fades."""
    made = simulate(campaign(element="maxwell", C_N_s_per_m=10.0))
    assert np.isinf(made.truth["time_to_peak_s"]).all()
    value = [trace.value for trace in made.traces]
    # The jump of the jerk at contact falls between samples.
    np.testing.assert_allclose([each.sum() / 10_000 for each in value], 1.5, rtol=1e-3)
