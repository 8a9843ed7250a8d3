"""A height of fall and a velocity beside it that contradict each other are both named."""

from __future__ import annotations

import pandas as pd
import pytest

import bayestissue as bt
from dataset_bench import deceleration


def falls(heights: list[float], velocities: list[float], column: str = "drop_height_cm"):
    table = pd.DataFrame(
        {"impact": list("abcd"), "subject": "s", "trial": "t", "mass_kg": [0.5, 0.6, 0.7, 0.8]}
        | {"velocity_m_s": velocities, column: heights}
    )
    traces = [deceleration(mass, v) for mass, v in zip(table["mass_kg"], velocities, strict=True)]
    data = bt.dataset(table, traces, quantity="deceleration", unit="m/s^2", gravity="drop")
    return [warning for warning in data.warnings if "after a fall" in warning.expected]


# sqrt(2 g h) of 7.5 cm and of 10 cm.
OF_75, OF_10 = 1.2128417044, 1.40047


@pytest.mark.parametrize("velocities", [[OF_75] * 4, [1.21] * 4])
def test_what_agrees_to_its_digits_is_not_named(velocities: list[float]) -> None:
    assert falls([7.5] * 4, velocities) == []
    assert falls([75] * 4, velocities, "drop_height_mm") == []
    assert falls([0.075] * 4, velocities, "drop_height_m") == []


def test_a_height_that_was_corrected_and_not_its_velocity() -> None:
    (named,) = falls([7.5, 10.0, 7.5, 7.5], [OF_75] * 4)
    assert (named.impact, named.column) == ("b", "velocity_m_s and drop_height_cm")
    assert named.value == "1.21284 m/s and 10"
    assert "1.4 m/s after a fall from drop_height_cm 10" in named.expected
    assert len(falls([10.0] * 4, [OF_75] * 4)) == 4


def test_velocities_that_were_measured_are_a_little_lower() -> None:
    assert falls([10.0] * 4, [0.98 * OF_10] * 4) == []
