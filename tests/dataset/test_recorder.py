"""The table ``[recorder]``: what it may say, and that it comes through every way in and out."""

from __future__ import annotations

import pytest
import tomlkit

import bayestissue as bt
from bayestissue.base.errors import InputError
from bayestissue.recordings.dataset import LowPassFilter
from cases import cases
from dataset_bench import SETTINGS, Lab, tables

SIGNAL = SETTINGS["signal"]


def declared(lab: Lab, text: str) -> None:
    lab.append("dataset.toml", f"\n[recorder]\n{text}\n")


@pytest.mark.parametrize("stated", cases(__file__))
def test_it_is_read_written_and_taken_as_an_argument(lab: Lab, tmp_path, stated):
    assert bt.read_dataset(lab.folder).recorder is None
    declared(lab, tomlkit.dumps(stated))
    recorder = LowPassFilter(**stated)
    data = bt.read_dataset(lab.folder)
    assert data.recorder == recorder
    assert bt.read_dataset(data.write(tmp_path / "again")).recorder == recorder
    impacts, traces = tables()
    for given in (recorder, stated):
        assert bt.dataset(impacts, traces, **SIGNAL, recorder=given).recorder == recorder
    assert str(recorder) in repr(data)


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
