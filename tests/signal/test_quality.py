"""Single detectors on impacts in closed form: what they find, and how often noise alone sets them off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from impacts_bench import Impact, Lab, Recorded, record
from scipy.stats import binom

from bayestissue.base.remedies import flags as flags_by_key
from bayestissue.recordings.dataset.dataset_file import Uncertainty
from bayestissue.recordings.signal import SignalOptions
from bayestissue.recordings.signal.padded_traces import stack
from bayestissue.recordings.signal.quality import inspect, raised
from bayestissue.recordings.signal.quality.samples import PulseAndRests, slope, wave

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


def in_series(late: float, noise: float = 0.005, velocity: float = 1.5, tau: float = 0.02) -> Lab:
    """Spring and damper in series, d = V w^2 e^(-t / 2 tau) sin(b t) / b, recorded from ``late`` on."""
    omega = 67.0
    b = np.sqrt(omega**2 - 1 / (4 * tau**2))
    time = np.arange(int(0.95 * np.pi / b * 1e4) - round(late * 1e4)) * 1e-4
    since = time + late + 0.3e-4
    d = 1.5 * omega**2 * np.exp(-since / (2 * tau)) * np.sin(b * since) / b
    random = np.random.default_rng(3)
    traces = [Recorded(time, d + noise * d.max() * random.standard_normal(time.size)) for _ in range(COUNT)]
    return replace(record([replace(TYPICAL, velocity=velocity)] * COUNT, 1e4), traces=traces)


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.001, 0.002, 0.004])
def test_a_recording_that_begins_after_contact_is_found_whatever_the_tissue(late):
    """An oscillator that begins at contact explains none of these, and one that begins before none either."""
    words = "begins above zero: after contact, or with an offset"
    assert all(words in row for row in flags(in_series(late)))
    assert flags(in_series(0.0)) == [[]] * COUNT


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


@dataclass
class Depths(Lab):
    quantity: str = "displacement"


def depths(first: float) -> Depths:
    time = np.arange(400) * 1e-3 / 10
    x = 0.02 * np.sin(np.pi / 2 * time / time[-1] * 1.2)
    begin = int(np.argmax(x >= first * 0.02))
    lab = record([TYPICAL] * COUNT, 1e4)
    return Depths(lab.impacts, [Recorded(time[begin:], x[begin:])] * COUNT)


def test_a_displacement_whose_first_sample_is_deep_is_found():
    assert all("contact came before the recording" in row[0] for row in flags(depths(0.1)))
    assert flags(depths(0.0)) == [[]] * COUNT


@pytest.mark.parametrize("length", [20, 100, 300])
def test_noise_alone_passes_for_a_wave_or_a_line_as_rarely_as_stated(length):
    count, level = 4000, 0.01
    values = np.random.default_rng(length).standard_normal((count, length))
    size = np.full(count, length)
    for p in (wave(values, size)[1], slope(values, size, np.zeros(count))[1]):
        low, high = binom.ppf([0.0005, 0.9995], count, level)
        assert low <= (p < level).sum() <= high


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "zeta"), [(2e3, 3.0), (2e3, 4.0), (5e3, 5.0), (5e3, 10.0)])
def test_a_force_that_jumps_at_contact_and_decays_at_once_is_no_spike(rate, zeta):
    """By a third in a sampling interval at the most."""
    lab = record([Impact(77.0, zeta)] * COUNT, rate, before=0.03, after=0.03, noise=0.003)
    assert found(lab, "a spike") == []
    traces = [Recorded(trace.time_s, trace.value.copy()) for trace in lab.traces]
    for trace in traces:
        trace.value[np.flatnonzero(trace.time_s > 0)[0] - 10] += trace.value.max()
    assert len(found(replace(lab, traces=traces), "a spike")) == COUNT


@pytest.mark.parametrize("rate", [250, 300, 400, 500])
def test_a_pulse_of_few_samples_is_no_spike_and_one_beside_it_is_found(rate):
    phases = np.arange(COUNT) / COUNT
    lab = record([TYPICAL] * COUNT, rate, before=0.1, after=0.1, noise=0.001, phase=phases)
    assert found(lab, "a spike") == []
    traces = [Recorded(trace.time_s, trace.value.copy()) for trace in lab.traces]
    for trace in traces:
        trace.value[10] += trace.value.max() / 2
    assert found(replace(lab, traces=traces), "a spike") == ["one at sample 11"] * COUNT


def test_the_pulse_is_found_beside_a_spike_above_it():
    lab = spoilt(lambda t, d: d + 2.0 * (np.arange(d.size) == 100))
    seen = PulseAndRests.from_recordings(stack(lab.traces))
    highest = TYPICAL.deceleration(np.linspace(0, TYPICAL.time_to_peak, 1000)).max()
    # Five standard deviations of the noise.
    assert seen.peak == pytest.approx([highest] * COUNT, rel=0.025)
    assert (seen.before.sum(axis=1) > 200).all()
