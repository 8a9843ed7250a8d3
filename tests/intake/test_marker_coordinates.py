"""Recordings in coordinates of their own: markers of a laboratory, a phone that was held and then dropped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.errors import InputError

G, RATE, VELOCITY, STIFFNESS = 9.80665, 1000.0, 1.2, 3000.0
FACTS = {"subject": "s1", "mass_kg": 1.0, "velocity_m_s": VELOCITY}


def impact(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth (m) and force over mass (m/s²) of 1 kg on a spring, contact at 0."""
    omega = np.sqrt(STIFFNESS)
    inside = (time > 0) & (time < np.pi / omega)
    depth = VELOCITY * np.where(
        inside, np.sin(omega * time) / omega, np.where(time <= 0, time, np.pi / omega - time)
    )
    return depth, np.where(inside, omega**2 * depth, 0.0)


def folder(tmp_path: Path, time: np.ndarray, value: np.ndarray) -> Path:
    recorded = tmp_path / "recorded"
    recorded.mkdir()
    pd.DataFrame({"time_s": time, "z": value}).to_csv(recorded / "s1.csv", index=False)
    return recorded


def test_a_marker_in_laboratory_coordinates_asks_for_the_zero(tmp_path: Path) -> None:
    time = np.arange(-50, 100) / RATE
    depth, _ = impact(time)
    height = 300 - 1e3 * depth + np.random.default_rng(0).normal(0, 0.01, time.size)
    recorded = folder(tmp_path, time + 0.05, height)
    how = {"quantity": "displacement", "unit": "mm", "given": FACTS}
    with pytest.raises(InputError, match=r"negative --scale .* in --offset, after the scale"):
        bt.init_dataset(recorded, tmp_path / "a", **how)
    data = bt.init_dataset(recorded, tmp_path / "b", **how, scale=-1.0)
    problems = bt.check(data).problems
    assert problems["code"].iloc[0] == "starts-deep"
    assert "stays below zero" in problems["remedy"].iloc[0]
    with pytest.raises(InputError, match=r"signal.offset.*a displacement that passes 0"):
        bt.fit(data)
    data = bt.init_dataset(recorded, tmp_path / "c", **how, scale=-1.0, offset=300.0)
    assert bt.check(data).problems.empty


@pytest.mark.parametrize(("quantity", "sign"), [("deceleration", -1), ("acceleration", 1)])
def test_a_phone_that_was_held_and_then_dropped_is_to_be_cropped(
    quantity: str, sign: int, tmp_path: Path
) -> None:
    time = np.arange(-2150, 100) / RATE
    _, force = impact(time)
    reading = force + np.where(time < -0.15, sign * G, 0.0)
    value = reading if quantity == "deceleration" else -reading
    value += np.random.default_rng(0).normal(0, 0.05, time.size)
    recorded = folder(tmp_path, time + 2.15, value)
    how = {"quantity": quantity, "unit": "m/s^2", "given": FACTS, "gravity": "none"}
    with pytest.raises(InputError, match=r"Read it from the fall on by --crop.*--zero") as refused:
        bt.init_dataset(recorded, tmp_path / "a", **how)
    assert {problem.code for problem in refused.value.problems} == {"sign"}
    data = bt.init_dataset(recorded, tmp_path / "b", **how, crop=(2.02, 2.2))
    assert abs(np.abs(data.traces[0].value).max() - VELOCITY * np.sqrt(STIFFNESS)) < 1
