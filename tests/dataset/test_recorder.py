"""The table ``[recorder]``: which filter it declares, and which can't have been there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import LowPassFilter
from dataset_bench import DAMPING, MASSES, RATE, SETTINGS, STIFFNESS, Lab, closed_form, tables

SIGNAL = SETTINGS["signal"]


def declared(lab: Lab, text: str) -> None:
    lab.append("dataset.toml", f"\n[recorder]\n{text}\n")


def test_without_one_the_hash_of_arrays_is_as_it_was():
    impacts, traces = tables()
    plain, other = (
        bt.dataset(impacts, traces, **SIGNAL, recorder=r) for r in (None, LowPassFilter(low_pass_hz=500.0))
    )
    assert plain.input_hash != other.input_hash
    assert other.with_settings(recorder=None).recorder is None


@pytest.mark.slow
def test_the_thesis_methods_say_that_they_leave_it_out(lab: Lab):
    declared(lab, "low_pass_hz = 500")
    table = bt.estimate(bt.read_dataset(lab.folder), method="dds")
    assert table["notes"].str.contains("the declared low-pass is not in this method").all()


def test_a_fit_of_displacements_refuses_it(lab: Lab):
    declared(lab, "low_pass_hz = 500")
    with pytest.raises(InputError, match=r'"impact", since dataset.toml declares a low-pass'):
        bt.fit(bt.read_dataset(lab.folder), "arma")


def test_of_zero_phase_can_be_the_samples_filter_alone_unless_stated():
    assert not LowPassFilter(low_pass_hz=500.0).digital
    assert LowPassFilter(low_pass_hz=500.0, applied="digital").digital
    assert LowPassFilter(low_pass_hz=500.0, zero_phase=True).digital
    assert not LowPassFilter(low_pass_hz=500.0, zero_phase=True, applied="analog").digital


def test_a_digital_filter_has_its_corner_below_half_of_the_sampling_rate():
    impacts, traces = tables()
    nyquist = 0.5 / traces["time_s"].diff().median()
    analog = {"low_pass_hz": 2 * nyquist}
    assert bt.dataset(impacts, traces, **SIGNAL, recorder=analog).recorder == LowPassFilter(**analog)
    with pytest.raises(InputError, match=r"half of the sampling rate.*analog") as raised:
        bt.dataset(impacts, traces, **SIGNAL, recorder=analog | {"applied": "digital"})
    (problem,) = raised.value.problems
    assert (problem.code, problem.value) == ("impossible-low-pass", f"{2 * nyquist:g} Hz")


def test_a_corner_that_nothing_as_fast_passes_is_refused_once_with_the_time_to_peak(lab: Lab):
    declared(lab, "low_pass_hz = 4.0")
    with pytest.raises(InputError) as raised:
        bt.read_dataset(lab.folder)
    (problem,) = raised.value.problems
    assert (problem.code, problem.value) == ("impossible-low-pass", "4 Hz")
    rise = float(problem.expected.split("which peak ")[1].split(" ms")[0])
    frequency = np.sqrt(STIFFNESS / np.array(MASSES))
    ratio = DAMPING * frequency / (2 * STIFFNESS)
    true = 1e3 * np.median(np.arccos(ratio) / (frequency * np.sqrt(1 - ratio**2)))
    # From a tenth of the peak on: of this tissue the force jumps to a quarter of it at contact.
    assert 0.4 * true < rise < true


@pytest.mark.parametrize(("corner", "order"), [(40.0, 2), (25.0, 4)])
def test_a_filter_that_is_really_there_is_never_refused(corner: float, order: int):
    """However slow: what it leaves of an impact of 20 ms is as slow as itself."""
    time = np.arange(1500) / RATE - 0.01
    force = closed_form(time, 0.7, 1.5, STIFFNESS, DAMPING)
    value = lfilter(*butter(order, 2 * corner / RATE), force)
    row = {"impact": ["a"], "subject": "s", "mass_kg": 0.7, "velocity_m_s": 1.5}
    bt.dataset(row, [(time, value)], **SIGNAL, recorder={"low_pass_hz": corner, "order": order})
