"""Tapped masses: the motion against an integration, the momentum, and what a recorder makes of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from bayestissue.dataset import read_dataset
from bayestissue.errors import InputError
from bayestissue.simulation import Simulation, read_simulation, simulate, write_campaign
from bayestissue.simulation.tap import acceleration, hammer_force

MASS, K, IMPULSE = 2.0, 8000.0, 0.4
PERIOD = 2 * np.pi * np.sqrt(MASS / K)
CONDITION = {"trial": "tap", "mass_kg": MASS, "impulse_N_s": IMPULSE}


def taps(duration: float, zeta: float = 0.08, **tables: Any) -> Simulation:
    """A mass on a spring and damper, tapped for this share of its period."""
    tissue = {"K_N_per_m": K, "C_N_s_per_m": 2 * zeta * np.sqrt(K * MASS)}
    content: dict[str, Any] = {
        "name": "taps",
        "design": {"subjects": 1, "conditions": (CONDITION,)},
        "tissue": tissue,
        "tap": {"duration_s": duration * PERIOD},
        "recording": {"sampling_rate_hz": 20_000.0, "force": {"place": "hammer"}},
    }
    return Simulation(**(content | tables))


def integrated(simulation: Simulation, truth: pd.Series, time: np.ndarray) -> np.ndarray:
    """x'' by a Runge-Kutta method of order 8, which begins anew where the hammer leaves."""
    assert simulation.tap is not None
    size, length = np.pi / 2 * truth["impulse_N_s"] / simulation.tap.duration_s, simulation.tap.duration_s
    M, damping, stiffness = (truth[name] for name in ("mass_kg", "C_N_s_per_m", "K_N_per_m"))

    def rate(t: float, state: np.ndarray) -> list[Any]:
        force = size * np.sin(np.pi * t / length) if np.all(t < length) else 0.0
        return [state[1], (force - damping * state[1] - stiffness * state[0]) / M]

    since, state, value = time - truth["contact_time_s"], [0.0, 0.0], np.zeros(len(time))
    for begin, end in ((0.0, length), (length, since[-1] + 1.0)):
        part = (since >= begin) & (since < end)
        times = [*since[part], end]
        solved = solve_ivp(rate, (begin, end), state, "DOP853", times, rtol=1e-12, atol=1e-14)
        force = np.where(since[part] < length, size * np.sin(np.pi * since[part] / length), 0.0)
        *(x, v), state = *solved.y[:, :-1], solved.y[:, -1]
        value[part] = (force - damping * v - stiffness * x) / M
    return value


@pytest.mark.parametrize("duration", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("zeta", [0.002, 0.08, 1.0, 1.0 + 1e-9, 2.5])
def test_the_motion_is_that_of_an_integration(duration: float, zeta: float) -> None:
    campaign = simulate(simulation := taps(duration, zeta))
    expected = integrated(simulation, campaign.truth.iloc[0], campaign.time)
    np.testing.assert_allclose(campaign.value, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_a_short_tap_leaves_its_impulse_as_momentum() -> None:
    """Undamped, M x'(T) / J is cos^2(omega T / 2) / (1 - (omega T / pi)^2): 1 to the order (omega T)^2."""
    for duration in (0.02, 0.01):
        simulation = taps(duration, zeta=1e-6, recording={"force": {"place": "hammer"}})
        assert simulation.tap is not None
        truth = simulate(simulation).truth
        begin, length = truth["contact_time_s"][0], simulation.tap.duration_s
        time = np.linspace(begin, begin + length, 20_001)
        speed = np.trapezoid(acceleration(simulation.tap, truth, time)[0], time)
        force = np.trapezoid(hammer_force(simulation.tap, truth, time)[0], time)
        assert force == pytest.approx(IMPULSE, rel=1e-7)
        angle = np.sqrt(K / MASS) * length
        ratio = np.cos(angle / 2) ** 2 / (1 - (angle / np.pi) ** 2)
        assert MASS * speed / IMPULSE == pytest.approx(ratio, rel=1e-6)
        assert 1 - ratio == pytest.approx((1 / 4 - 1 / np.pi**2) * angle**2, rel=0.01)


def test_the_recording_begins_before_the_tap_and_ends_when_the_ringing_has() -> None:
    campaign = simulate(simulation := taps(0.05))
    truth, tap = campaign.truth.iloc[0], simulation.tap
    assert tap is not None
    begin, end = truth["contact_time_s"], truth["contact_time_s"] + tap.duration_s
    assert begin == pytest.approx(0.01, abs=1e-4)
    assert not campaign.value[campaign.time <= begin].any()
    left = -np.log(0.01) / (truth["zeta"] * truth["omega_n_rad_s"])
    assert campaign.time[-1] == pytest.approx(end + left + 0.01, abs=1e-4)
    assert simulate(taps(0.05, 0.001)).time[-1] == pytest.approx(end + 2.0 + 0.01, abs=1e-3)
    shorter = {"tap": {"duration_s": 0.005, "ringing_s": 0.1}}
    assert simulate(taps(0.05, **shorter)).time[-1] == pytest.approx(begin + 0.115, abs=1e-3)


def test_the_truth_has_what_made_the_recordings() -> None:
    chain = {
        "relative_gain_sd": 0.02,
        "offset_sd_m_s2": 0.1,
        "noise_sd_m_s2": 0.05,
        "mass_factor": 1.5,
        "relative_mass_sd": 0.4,
        "force": {"place": "hammer", "relative_gain_sd": 0.03, "offset_sd_N": 0.5, "noise_sd_N": 0.2},
    }
    design = {"subjects": 40, "conditions": (CONDITION,)}
    simulation = taps(0.05, recording=chain, design=design)
    campaign = simulate(simulation)
    truth, data = campaign.truth, campaign.dataset("taps")
    assert data.tapped
    assert data.quantity == "acceleration"
    assert data.impacts["velocity_m_s"].isna().all()
    assert (truth["impulse_N_s"] == IMPULSE).all()
    scatter = np.log(truth["mass_kg"] / MASS / 1.5)
    assert scatter.std() == pytest.approx(0.4, rel=4 / np.sqrt(2 * 40))
    np.testing.assert_allclose(truth["omega_n_rad_s"] ** 2 * truth["mass_kg"], truth["K_N_per_m"])
    assert data.uncertainty.relative_mass_sd == 0.4
    assert data.channels[0].relative_gain_sd == 0.03
    assert simulation.tap is not None
    for row, trace, channel in zip(truth.index, data.traces, data.channels[0].traces, strict=True):
        one = truth.loc[[row]]
        force = hammer_force(simulation.tap, one, trace.time_s)[0]
        exact = acceleration(simulation.tap, one, trace.time_s)[0]
        residual = trace.value - one["gain"].item() * exact - one["offset_m_s2"].item()
        assert np.std(residual) == pytest.approx(0.05, rel=6 / np.sqrt(2 * residual.size))
        residual = channel.value - one["force_gain"].item() * force - one["force_offset_N"].item()
        assert np.std(residual) == pytest.approx(0.2, rel=6 / np.sqrt(2 * residual.size))


def test_a_force_that_is_late_is_the_same_one_later() -> None:
    late = {"sampling_rate_hz": 20_000.0, "force": {"place": "hammer", "delay_s": 0.001}}
    forces = [simulate(simulation).force for simulation in (taps(0.05), taps(0.05, recording=late))]
    assert forces[0] is not None
    assert forces[1] is not None
    np.testing.assert_allclose(forces[1][20:], forces[0][:-20], atol=1e-9)


def test_it_is_written_and_read_back(tmp_path: Path) -> None:
    campaign = simulate(simulation := taps(0.05))
    write_campaign(tmp_path / "taps", campaign, simulation)
    data = read_dataset(tmp_path / "taps")
    assert data.recorded == "tapped"
    assert not data.warnings
    np.testing.assert_allclose(data.traces[0].value, campaign.dataset("taps").traces[0].value, rtol=1e-12)
    truth = pd.read_csv(tmp_path / "taps" / "truth.csv")
    assert {"K_N_per_m", "C_N_s_per_m", "mass_kg", "omega_n_rad_s", "zeta", "impulse_N_s"} <= set(truth)
    assert "velocity_m_s" not in pd.read_csv(tmp_path / "taps" / "impacts.csv")


def without(text: str, part: str) -> str:
    assert part in text
    return text.replace(part, "")


SPECIFICATION = """name = "taps"

[design]
subjects = 1

[[design.conditions]]
trial = "tap"
mass_kg = 2.0
impulse_N_s = 0.4

[tissue]
K_N_per_m = 8000.0
C_N_s_per_m = 20.0

[tap]
duration_s = 0.005

[recording]
relative_mass_sd = 1.0

[recording.force]
place = "hammer"
"""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: without(text, "[tap]\nduration_s = 0.005\n"), "all of these, or none"),
        (lambda text: without(text, 'place = "hammer"\n'), "relative_mass_sd below 0.3"),
        (lambda text: text.replace("impulse_N_s = 0.4", "velocity_m_s = 1.0"), "all of these, or none"),
        (lambda text: text.replace("mass_kg = 2.0\n", ""), "mass_kg alone beside impulse_N_s"),
        (
            lambda text: (
                text.replace("subjects = 1", "subjects = 1\n", 1) + "\n[recorder]\nlow_pass_hz = 100.0\n"
            ),
            "[recorder]",
        ),
        (lambda text: 'gravity = "drop"\nheadform = true\n' + text, "gravity; headform"),
        (lambda text: text.replace("[tap]", 'element = "maxwell"\n[tap]'), "spring and damper side"),
        (lambda text: text + "tip_mass_kg = 0.1\n", "tip_mass_kg"),
        (lambda text: text.replace("relative_mass_sd = 1.0", 'contact = "on_sample"'), "recording.contact"),
        (lambda text: text.replace("relative_mass_sd = 1.0", "relative_mass_sd = 2.5"), "less than 2"),
    ],
)
def test_what_does_not_go_with_a_tap_is_refused(
    tmp_path: Path, change: Callable[[str], str], words: str
) -> None:
    path = tmp_path / "taps.toml"
    path.write_text(SPECIFICATION)
    read_simulation(path)
    path.write_text(change(SPECIFICATION))
    with pytest.raises(InputError) as refused:
        read_simulation(path)
    assert words in str(refused.value)


def test_a_delay_is_of_a_hammer_alone() -> None:
    with pytest.raises(ValueError, match="delay_s only"):
        taps(0.05, recording={"force": {"place": "base", "delay_s": 0.001}}, tap=None)
