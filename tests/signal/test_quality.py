"""Single detectors on impacts in closed form: what they find, and how often noise alone sets them off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from impacts_bench import Impact, Lab, Recorded, record
from scipy.stats import binom

from bayestissue.base.remedies import flags as flags_by_key
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.recordings.signal import SignalOptions
from bayestissue.recordings.signal.quality import inspect, raised
from bayestissue.recordings.signal.quality.samples import slope, wave

TYPICAL = Impact(67.0, 0.28)
COUNT = 5


def spoilt(change: Callable[[np.ndarray, np.ndarray], np.ndarray], before: float = 0.03, **how: float) -> Lab:
    """Impacts at 10 kHz with 0.5 % of noise, changed as functions of time since contact and of the peak."""
    random = np.random.default_rng(1)

    def changed(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        peak = value.max()
        return time, peak * (change(time, value / peak) + 0.005 * random.standard_normal(value.size))

    return record([TYPICAL] * COUNT, 1e4, before=before, after=0.03, noise=0.0, **how).changed(changed)


def flags(lab: Lab, options: SignalOptions | None = None) -> list[list[str]]:
    return raised(inspect(lab, options), COUNT)


def found(lab: Lab, words: str) -> list[str]:
    """What is said where the flag begins with these words."""
    kinds = ((flags_by_key()[key], said) for key, said in inspect(lab).items())
    return [one for kind, said in kinds if kind.says.startswith(words) for one in said]


def test_a_sound_recording_is_left_alone():
    assert flags(spoilt(lambda t, d: d)) == [[]] * COUNT


@pytest.mark.parametrize(("true", "declared"), [(9.80665, 0.0), (0.0, 9.80665), (9.80665, 9.80665)])
def test_gravity_that_is_declared_otherwise_than_it_is_is_found(true, declared):
    lab = record([replace(TYPICAL, gravity=true)] * COUNT, 1e4, before=0.03, after=0.03, noise=0.005)
    words = f"looks like {'no ' * (true == 0)}gravity along the motion"
    rows = flags(replace(lab, gravity=declared))
    assert [any(flag.startswith(words) for flag in row) for row in rows] == [true != declared] * COUNT
    assert true != declared or rows == [[]] * COUNT


def test_an_impactor_that_stays_on_the_tissue_has_no_other_zero():
    drop = replace(TYPICAL, zeta=0.7, gravity=9.80665)
    lab = record([drop] * COUNT, 1e4, before=0.03, noise=0.002)
    time, traces = np.arange(-300, 2000) * 1e-4, []
    for row in range(COUNT):
        force = 9.80665 - drop.derivative(2, np.maximum(time, 0))
        noise = 0.002 * force.max() * np.random.default_rng(row).standard_normal(len(time))
        traces.append(Recorded(time, np.where(time >= 0, force, 0) + noise))
    assert flags(replace(lab, traces=traces)) == [[]] * COUNT


def test_a_plateau_with_noise_on_it_is_found():
    for row in flags(spoilt(lambda t, d: np.minimum(d, 0.7))):
        assert row == ["no force of depth and velocity gives this trace"]


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.001, 0.002, 0.004])
def test_a_recording_that_begins_after_contact_is_found(late):
    lab = spoilt(lambda t, d: d, before=-late)
    assert flags(lab) == [["begins above zero: after contact, or with an offset"]] * COUNT
    # Unless time 0 is said to be contact.
    assert flags(lab, SignalOptions(contact="time-zero")) == [[]] * COUNT


def test_where_noise_hides_when_contact_was_a_note_says_so():
    impacts = [replace(TYPICAL, zeta=0.5)] * COUNT
    lab = record(impacts, 1e4, before=0.0, after=0.03, noise=0.02)
    findings = inspect(lab)
    assert raised(findings, COUNT) == [[]] * COUNT
    noted = raised(findings, COUNT, notes=True).count(["contact may have come before the first sample"])
    # Chance excludes the least of the earlier moments in one of twenty.
    assert noted >= binom.ppf(1e-3, COUNT, 0.95)
    assert raised(inspect(lab, SignalOptions(contact="time-zero")), COUNT, notes=True) == [[]] * COUNT
    # Noise of a thousandth of the peak leaves no doubt.
    clear = record(impacts, 1e4, before=0.0, after=0.03, noise=0.001)
    assert raised(inspect(clear), COUNT, notes=True) == [[]] * COUNT


def test_a_velocity_that_is_off_as_much_as_declared_is_no_late_beginning():
    """By 2 %; sound recordings cropped at contact."""
    lab = record([TYPICAL] * COUNT, 1e4, before=0.0, after=0.03, noise=0.005)
    lab.impacts["velocity_m_s"] *= 1.02
    assert all("begins above zero: after contact, or with an offset" in row for row in flags(lab))
    declared = replace(lab, uncertainty=Uncertainty(velocity_sd_m_s=0.02 * TYPICAL.velocity))
    assert flags(declared) == [[]] * COUNT


def test_an_isolated_spike_before_contact_is_found_where_it_is():
    spiked = spoilt(lambda t, d: d + 0.5 * (np.arange(d.size) == 150))
    assert found(spiked, "a spike") == ["one at sample 151"] * COUNT


def test_a_zero_that_moves_during_the_impact_is_found():
    said = found(spoilt(lambda t, d: d + 0.05 * (t > 0.02)), "the zero after contact")
    sizes = [float(each.removeprefix("a difference of ").split("%")[0]) for each in said]
    # Means of some 200 samples of 0.5 % each.
    assert sizes == pytest.approx([5.0] * COUNT, abs=5 * 0.5 * np.sqrt(2 / 200))


@pytest.mark.parametrize("hertz", [50, 60])
def test_hum_is_called_hum_with_its_frequency(hertz):
    said = found(spoilt(lambda t, d: d + 0.05 * np.sin(2 * np.pi * hertz * t + 1)), "hum")
    assert [float(each.removeprefix("a wave of ").removesuffix(" Hz")) for each in said] == pytest.approx(
        [hertz] * COUNT, abs=5
    )


def test_drift_is_called_drift():
    assert flags(spoilt(lambda t, d: d + 5 * t)) == [["drift while nothing is touched"]] * COUNT


def test_samples_that_repeat_are_found():
    lab = spoilt(lambda t, d: d)
    held = [Recorded(t.time_s, t.value[np.arange(t.value.size) // 4 * 4]) for t in lab.traces]
    assert all("samples that repeat the one before" in row for row in flags(replace(lab, traces=held)))


@pytest.mark.parametrize("length", [20, 100, 300])
def test_noise_alone_passes_for_a_wave_or_a_line_as_rarely_as_stated(length):
    count, level = 4000, 0.01
    values = np.random.default_rng(length).standard_normal((count, length))
    size = np.full(count, length)
    for p in (wave(values, size)[1], slope(values, size, np.zeros(count))[1]):
        low, high = binom.ppf([0.0005, 0.9995], count, level)
        assert low <= (p < level).sum() <= high


@pytest.mark.parametrize(("rate", "zeta"), [(250, 0.28), (400, 0.28), (2e3, 4.0), (5e3, 10.0)])
def test_a_short_pulse_or_a_jump_that_decays_at_once_is_no_spike_and_one_beside_it_is_found(rate, zeta):
    phases = np.arange(COUNT) / COUNT
    lab = record([Impact(67.0, zeta)] * COUNT, rate, before=0.1, after=0.1, noise=0.001, phase=phases)
    assert found(lab, "a spike") == []
    traces = [Recorded(trace.time_s, trace.value.copy()) for trace in lab.traces]
    for trace in traces:
        trace.value[10] += trace.value.max() / 2
    assert found(replace(lab, traces=traces), "a spike") == ["one at sample 11"] * COUNT
