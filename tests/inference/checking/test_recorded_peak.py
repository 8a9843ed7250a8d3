"""Recorded peaks outside their intervals: sound ones are never called so, shocks of another law are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from bayestissue.base.resources import shared
from bayestissue.inference.checking.findings import PEAK_MISSED, headline, noted, warnings
from bayestissue.inference.checking.recording_warnings import judge_peaks, missed_peaks
from bayestissue.model.hierarchy.specification import read_specification
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.recordings.dataset import Dataset, Uncertainty
from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from campaigns import simulated, spreads

DT = 1 / 51_200


def of_true_peaks(
    noise: float, gravity: str = "none", impacts: int = 200
) -> tuple[Dataset, Prepared, np.ndarray]:
    """Simulated impacts of a spring and damper, and the true peak of each [standard gravity]."""
    made = simulated(
        spreads(impact=0.3), {"noise_relative_to_peak": noise}, people=impacts, seed=3, gravity=gravity
    )
    dataset = made.dataset("sound")
    ready = prepare(dataset, read_specification(shared("models", "impact.toml")), source="test")
    return dataset, ready, made.truth["peak_deceleration_g"].to_numpy(float)


@pytest.mark.parametrize(
    ("noise", "gravity"),
    [(0.2, "none"), (0.005, "none"), pytest.param(0.2, "drop", marks=pytest.mark.slow)],
)
def test_noise_takes_no_sample_out_of_an_interval_that_is_the_true_peak_alone(noise, gravity) -> None:
    dataset, ready, peak = of_true_peaks(noise, gravity)
    jerk = np.full(len(peak), 1e5)
    assert not missed_peaks(dataset, ready, peak, peak, jerk).any()


def test_a_peak_beyond_noise_gain_and_zero_is_missed_on_either_side() -> None:
    dataset, ready, peak = of_true_peaks(0.005, impacts=40)

    def missed(data: Dataset, given: Prepared, low: float = 0.5, jerk: float = 0.0) -> np.ndarray:
        """Of intervals from so much of the peak to 0.4 of it more."""
        return missed_peaks(data, given, low * peak, (low + 0.4) * peak, np.full(len(peak), jerk))

    # Five standard deviations of the noise and 1 % of the peak are 3.5 % of it.
    assert missed(dataset, ready).all()
    assert missed(dataset, ready, 1.1).all()
    assert not missed(dataset, ready, 1.1, np.inf).any()
    for uncertainty in (Uncertainty(relative_gain_sd=0.05), Uncertainty(offset_sd=5.0)):
        of_quiet = ready if uncertainty.relative_gain_sd else without_quiet_part(ready)
        assert not missed(dataset.with_settings(uncertainty=uncertainty), of_quiet).any()
    assert not missed(dataset.with_settings(recorder=LowPassFilter(low_pass_hz=300.0)), ready).any()
    arma = replace(ready, model=replace(ready.model, kind="arma"))
    limited = replace(ready, signal=replace(ready.signal, clipped=np.ones_like(ready.signal.clipped)))
    for other in (arma, limited):
        assert not missed(dataset, other).any()


def without_quiet_part(ready: Prepared) -> Prepared:
    quiet = ready.signal.quiet
    unknown = quiet._replace(there=np.zeros_like(quiet.there))
    return replace(ready, signal=replace(ready.signal, quiet=unknown))


def test_a_missed_peak_is_in_the_first_line_the_warnings_and_its_rows() -> None:
    dataset, ready, peak = of_true_peaks(0.005, impacts=40)
    names = ready.impacts["impact"].astype(str).tolist()
    high = np.where(np.arange(40) == 7, 0.9, 1.05) * peak
    summary = pd.DataFrame(
        {"variable": "peak_deceleration", "label": names, "eti90_low": 0.8 * peak, "eti90_high": high}
    )
    found = {"passed": True, "recorded_peak": judge_peaks(dataset, ready, summary)}
    assert found["recorded_peak"]["impacts"] == [names[7]]
    assert headline(found).endswith("but the recorded peak of 1 of 40 impacts is outside its interval.")
    (warning,) = warnings(found)
    assert warning.code == "peak-missed"
    assert f"the interval is {0.8 * peak[7]:.4g} to {0.9 * peak[7]:.4g} g" in warning
    assert 'discrepancy = "always"' in warning
    notes = noted(summary, found)["note"]
    assert notes[7] == PEAK_MISSED
    assert notes.ne("").sum() == 1
    assert judge_peaks(dataset, ready, summary.assign(eti90_high=1.05 * peak)) == {}
    assert judge_peaks(dataset, ready, summary.iloc[:0]) == {}


@pytest.mark.slow
def test_a_sharp_shock_of_few_samples_is_flagged() -> None:
    # A pulse A exp(-|t| / T), which rises and falls over 14 samples at the height of 10 % and more.
    time = np.arange(-12, 10) * DT
    pulse = 40_000 * np.exp(-np.abs(time) / (3 * DT))
    rng = np.random.default_rng(2)
    velocity = 40_000 * 3 * DT
    rows = pd.DataFrame({"impact": list("abcd"), "subject": list("abcd"), "trial": "t"})
    traces = [(DT * np.arange(len(pulse)), pulse + 20 * rng.standard_normal(len(pulse))) for _ in rows.index]
    rows = rows.assign(mass_kg=1.0, velocity_m_s=velocity)
    errors = {"velocity_sd_m_s": 0.2 * velocity}
    shocks = bt.dataset(rows, traces, quantity="deceleration", unit="m/s^2", uncertainty=errors)
    flags = bt.estimate(shocks)["flags"]
    assert flags.str.contains(PEAK_MISSED, regex=False).all()
