"""A declared low-pass that nothing as fast as the recordings passes is refused, once, with both numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

import bayestissue as bt
from bayestissue.studies.simulation import Simulation, simulate, write_campaign
from command_line import bayestissue

CONTENT = {
    "name": "slow",
    "seed": 1,
    "design": {"conditions": [{"trial": "a", "mass_kg": 0.7, "velocity_m_s": 1.5}], "subjects": 6},
    "tissue": {"K_N_per_m": 3000.0, "C_N_s_per_m": 25.0},
    "recording": {"noise_relative_to_peak": 0.005, "sampling_rate_hz": 5000.0},
    "output": {"traces": "csv"},
}


@pytest.fixture(scope="module")
def made():
    return simulate(Simulation.model_validate(CONTENT))


def arrays(made):
    data = made.dataset("slow")
    return data.impacts, [(trace.time_s, trace.value) for trace in data.traces]


@pytest.mark.parametrize("hertz", [0.001, 1.0, 4.0])
def test_one_problem_names_the_corner_and_the_time_to_peak(made, hertz):
    impacts, traces = arrays(made)
    with pytest.raises(bt.InputError) as raised:
        bt.dataset(impacts, traces, quantity="deceleration", unit="m/s^2", recorder={"low_pass_hz": hertz})
    (problem,) = raised.value.problems
    assert problem.code == "impossible-low-pass"
    assert problem.value == f"{hertz:g} Hz"
    rise = float(problem.expected.split("which peak ")[1].split(" ms")[0])
    # From a tenth of the peak on: of this tissue the force jumps to a quarter of it at contact.
    true = made.truth["time_to_peak_s"].median() * 1e3
    assert 0.4 * true < rise < true


def test_one_impact_by_itself_is_refused_too(made):
    (time, value), *_ = arrays(made)[1]
    with pytest.raises(bt.InputError, match="1 Hz"):
        bt.impact(time, value, mass_kg=0.7, velocity_m_s=1.5, recorder={"low_pass_hz": 1.0})


@pytest.mark.parametrize("recorder", [{"low_pass_hz": 40.0}, {"low_pass_hz": 25.0, "order": 4}])
def test_a_filter_that_is_really_there_is_never_refused(recorder):
    """However slow: what it leaves of an impact of 20 ms is as slow as itself."""
    behind = simulate(Simulation.model_validate({**CONTENT, "recorder": recorder}))
    impacts, traces = arrays(behind)
    bt.dataset(impacts, traces, quantity="deceleration", unit="m/s^2", recorder=recorder)


@pytest.mark.parametrize("command", [["check"], ["estimate", "--out"], ["fit", "--out"]])
def test_commands_end_with_status_2_and_write_nothing(made, tmp_path: Path, command):
    folder = tmp_path / "slow"
    write_campaign(folder, made, Simulation.model_validate(CONTENT))
    settings = folder / "dataset.toml"
    settings.write_text(settings.read_text() + "\n[recorder]\nlow_pass_hz = 1.0\n")
    name, *out = command
    done = bayestissue(name, folder, *out, *([tmp_path / "out"] if out else []))
    assert done.status == 2
    assert "1 Hz" in done.err
    assert " ms (median)" in done.err
    assert "impossible-low-pass" in done.err
    assert not (tmp_path / "out").exists()
