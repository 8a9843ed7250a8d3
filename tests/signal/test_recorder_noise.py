"""Whether noise went through the filter: asked of simulated recordings, whose share is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import bessel, butter, freqs, sosfilt, sosfiltfilt

from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.filters import autocorrelation, white_share
from bayestissue.studies.simulation import Simulation, simulate

NOISE = 2.0
SAE, SLOW = {"sae_class": 180}, {"low_pass_hz": 500.0}


def recorded(recorder: dict, impacts: int = 12, **recording: float) -> Dataset:
    """Impacts with a long quiet part, their noise before the filter; nothing of that is declared."""
    content = {
        "name": "noise",
        "seed": 2,
        "design": {"conditions": [{"trial": "a", "mass_kg": 0.6, "velocity_m_s": 1.5}], "subjects": impacts},
        "tissue": {"K_N_per_m": 32_000.0, "C_N_s_per_m": 60.0},
        "recording": {"noise_sd_m_s2": NOISE, "before_contact_s": 0.03, **recording},
        "recorder": {"noise": "before", **recorder},
    }
    found = simulate(Simulation.model_validate(content)).dataset("noise")
    assert found.recorder is not None
    return found.with_settings(recorder=found.recorder.model_copy(update={"noise": None}))


def with_white(data: Dataset, sd: float) -> Dataset:
    """The same with further noise behind the filter."""
    random = np.random.default_rng(1)
    more = [
        Trace(each.time_s, each.value + sd * random.standard_normal(each.value.size)) for each in data.traces
    ]
    return replace(data, traces=more)


def designed(recorder: LowPassFilter, corner: float, **how: Any) -> Any:
    if recorder.kind == "bessel":
        return bessel(recorder.order, corner, norm="mag", **how)
    return butter(recorder.order, corner, **how)


@pytest.mark.parametrize(
    "recorder",
    [
        LowPassFilter(low_pass_hz=800.0, order=1),
        LowPassFilter(low_pass_hz=700.0, order=5, kind="bessel"),
        LowPassFilter(low_pass_hz=900.0, order=3, zero_phase=True, applied="analog"),
    ],
    ids=str,
)
def test_the_autocorrelation_is_the_spectrums(recorder: LowPassFilter):
    frequency = np.linspace(0, 4e5, 400_001)
    of_filter = designed(recorder, 2 * np.pi * recorder.low_pass_hz, analog=True)
    _, passed = freqs(*of_filter, worN=2 * np.pi * frequency)
    power = np.abs(passed) ** (4 if recorder.zero_phase else 2)
    lag = np.array([[0, -1], [3, 10]])
    expected = np.trapezoid(power * np.cos(2 * np.pi * frequency * 1e-4 * lag[..., None]), frequency)
    # Of one pole a thousandth lies beyond the greatest frequency.
    tolerance = 2e-3 if recorder.order == 1 else 1e-5
    np.testing.assert_allclose(
        autocorrelation(recorder, lag, 1e-4), expected / expected[0, 0], rtol=tolerance, atol=tolerance
    )


@pytest.mark.parametrize(
    "recorder",
    [
        LowPassFilter(low_pass_hz=1250.0, applied="digital"),
        LowPassFilter(low_pass_hz=700.0, order=5, kind="bessel", applied="digital"),
        LowPassFilter(low_pass_hz=1250.0, order=3, zero_phase=True),
    ],
    ids=str,
)
def test_the_autocorrelation_of_samples_is_that_of_the_answer_to_one(recorder: LowPassFilter):
    sections = designed(recorder, recorder.low_pass_hz, fs=1e4, output="sos")
    answer = (sosfiltfilt if recorder.zero_phase else sosfilt)(sections, np.eye(1, 2000, 1000)[0])
    lag = np.array([0, 1, -2, 5, 12])
    expected = np.array([(answer[abs(k) :] * answer[: len(answer) - abs(k)]).sum() for k in lag])
    np.testing.assert_allclose(autocorrelation(recorder, lag, 1e-4), expected / expected[0], atol=1e-6)


def test_the_quiet_parts_tell_the_share():
    data = recorded(SAE)
    for share in (0.0, 0.2, 0.7):
        sd = NOISE * (share / (1 - share)) ** 0.5
        mixed = with_white(data, sd)
        found = white_share(mixed, displacements(mixed))
        # The grid's step is 16 %; of some twelve hundred samples white noise is told to a few per cent.
        assert found == pytest.approx(share, rel=0.25, abs=0.002)
    still = replace(data, traces=[Trace(each.time_s, 0 * each.value) for each in data.traces])
    white = with_white(still, NOISE)
    assert white_share(white, displacements(data)) > 0.95


def test_without_a_quiet_part_it_goes_by_what_is_declared_and_by_the_filter():
    for recorder, share in ((SAE, 0.0), (SLOW, 1.0)):
        data = recorded(recorder, 2)
        late = [Trace(each.time_s[285:], each.value[285:]) for each in data.traces]
        short = replace(data, traces=late)
        signal = displacements(short)
        assert white_share(short, signal) == share
        assert data.recorder is not None
        for noise, expected in (("before", 0.0), ("after", 1.0)):
            other = data.with_settings(recorder=data.recorder.model_copy(update={"noise": noise}))
            assert white_share(other, displacements(other)) == expected
        # A quiet part that a recorder rounded to one number tells nothing.
        whole = displacements(data)
        flat = [Trace(each.time_s, np.where(each.time_s < 0.03, 0.0, each.value)) for each in data.traces]
        assert white_share(replace(data, traces=flat), whole) == share
