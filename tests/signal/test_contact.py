from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from impacts_bench import Impact, Lab, Recorded, record

from bayestissue.recordings.signal import SignalOptions, displacements
from bayestissue.recordings.signal.displacement import BEFORE, NO_CONTACT, TOO_FEW, since_release
from bayestissue.recordings.signal.padded_traces import stack
from bayestissue.recordings.signal.quality import inspect, raised

PHASES = np.random.default_rng(3).uniform(size=40)


@pytest.mark.parametrize(("rate", "zeta"), [(2e3, 0.28), (1e4, 0.1), (1e4, 1.0), (5e4, 0.28)])
def test_contact_is_found_within_a_sample_in_noise_and_errs_by_as_much_as_is_said(rate, zeta):
    lab = record([Impact(67.0, zeta)] * 40, rate, before=0.02, phase=PHASES, noise=0.005, offset=5.0)
    made = displacements(lab)
    assert np.abs(made.contact_time_s).max() < 1 / rate
    score = np.sqrt(np.mean((made.contact_time_s / made.contact.sd) ** 2))
    # The root mean square of 40 standardised errors has a standard error of 0.11; three of them.
    assert 0.66 < score < 1.34


@pytest.mark.parametrize("zeta", [0.02, 2.0])
def test_contact_of_a_recording_cut_there_lies_within_an_interval_of_its_first_sample(zeta):
    lab = record([Impact(67.0, zeta)] * 20, 1e4, before=0.0, noise=0.005)
    made = displacements(lab)
    assert (made.contact.since_s * 1e4 < 1.0).all()
    # Of forty values hardly one is beyond three standard deviations.
    assert (made.contact.since_s < 3 * made.contact.sd).all()


def test_time_zero_is_contact_where_the_options_say_so_and_flagged_where_it_is_far_from_it():
    lab = record([Impact(67.0, 0.28)] * 5, 1e4, before=0.02, phase=0.4, noise=0.02)
    made = displacements(lab, SignalOptions(contact="time-zero"))
    np.testing.assert_allclose(made.contact_time_s, 0, atol=1e-12)
    np.testing.assert_allclose(made.contact.since_s, 0.4e-4, rtol=1e-6)
    assert (made.contact.sd == 0).all()
    assert made.flags == [[]] * 5
    far = displacements(lab.moved(0.004), SignalOptions(contact="time-zero"))
    assert far.flags == [["contact as chosen is more than 1 ms from where the trace shows it"]] * 5
    assert displacements(lab.moved(0.004)).flags == [[]] * 5


def test_a_threshold_is_passed_later_than_contact():
    lab = record([Impact(67.0, 0.02)], 1e4, before=0.02)
    late = displacements(lab, SignalOptions(contact="threshold"))
    # d is nearly V omega (sin(omega t) + 2 zeta), a twentieth of its peak of 0.97 at about 0.0085 / omega.
    assert late.contact_time_s[0] == pytest.approx(0.0085 / 67, rel=0.1)


def test_a_blip_before_contact_is_not_contact():
    lab = record([Impact(67.0, 0.28)], 1e4, before=0.05, noise=0.002)
    lab.traces[0].value[100:104] += 15.0
    made = displacements(lab)
    assert abs(made.contact_time_s[0]) < 1e-4


def test_before_the_samples_are_asked_contact_lies_anywhere_between_two_of_them():
    lab = record([Impact(67.0, 0.28)] * 40, 1e4, before=0.02, phase=PHASES, noise=0.005)
    made = displacements(lab)
    np.testing.assert_allclose(made.contact.bracket_s, 0.5e-4, rtol=1e-6)
    np.testing.assert_allclose(made.contact.bracket_sd, 1e-4 / np.sqrt(12), rtol=1e-6)
    given = displacements(lab, SignalOptions(contact="time-zero"))
    np.testing.assert_allclose(given.contact.bracket_s, given.contact.since_s)
    assert not given.contact.bracket_sd.any()


def test_samples_before_the_first_are_kept_without_their_offset():
    lab = record([Impact(67.0, 0.28)] * 5, 1e4, before=0.02, phase=0.4, offset=5.0)
    made = displacements(lab)
    assert made.before.value.shape == (5, BEFORE)
    assert (made.before.n_samples == BEFORE).all()
    np.testing.assert_allclose(made.before.value, 0.0, atol=1e-6)


def test_a_force_that_rises_from_zero_may_have_begun_well_before_it_shows():
    """A rise by half a standard deviation a sample shows after ten samples or so."""
    time, noise = np.arange(-200, 200) * 1e-4, np.random.default_rng(2).standard_normal((40, 400))
    traces = [Recorded(time, 0.5 * np.maximum(time, 0.0) / 1e-4 + each) for each in noise]
    lab = replace(record([Impact(67.0, 0.28)] * 40, 1e4), traces=traces, contact="between")
    made = displacements(lab)
    first = made.contact_time_s + made.contact.since_s
    assert (made.before.reach_s > first).all()
    assert np.median(first) > 5e-4
    assert (displacements(lab, SignalOptions(contact="time-zero")).before.reach_s == 0).all()


@pytest.mark.parametrize("zeta", [2.5, 4.0])
def test_contact_on_a_strong_damper_is_where_its_spring_pushes(zeta):
    """A spring that pulls, and contact elsewhere in the interval, explain the trace as well."""
    lab = record([Impact(60.0, zeta)] * 40, 5e3, before=0.01, after=0.01, phase=PHASES, noise=1e-4)
    made = displacements(lab)
    # Six of its standard errors, which are 0.03 of an interval at the most.
    assert np.abs(made.contact_time_s * 5e3).max() < 0.2
    assert not any(made.flags)


def test_a_zero_measured_in_great_noise_errs_by_as_much_as_is_said():
    """A mean of means that overlap errs by 1.6 times as much as one of as many samples."""
    lab = record([Impact(60.0, 0.3)] * 200, 5e3, before=0.01, noise=0.2, offset=3.0)
    made = displacements(lab)
    assert made.before.blurred.all()
    assert np.isfinite(made.quiet.offset_sd).all()
    error = (made.quiet.offset - 3.0) / made.quiet.offset_sd
    # Four standard errors of a standard deviation of 200 values, and some for its own noise being estimated.
    assert error.std() == pytest.approx(1.0, abs=4 / 400**0.5)
    # The quiet part tells the zero: what is said to come between it and the first sample does not.
    assert (made.before.n_since_quiet < 50).all()


def test_great_noise_leaves_contact_in_its_bracket():
    lab = record([Impact(60.0, 0.4)] * 40, 5e3, before=0.02, phase=PHASES, noise=0.2)
    made = displacements(lab)
    assert made.before.blurred.all()
    late = made.contact_time_s + made.contact.since_s
    assert ((late >= 0) & (late <= 2 * made.contact.bracket_s)).mean() > 0.95
    assert (2 * made.contact.bracket_s <= BEFORE * made.dt).all()


def held(lab: Lab, offset: float = 0.0, ring: float = 0.0) -> Lab:
    """The same drops from a hand that holds the mass for 0.3 s, and lets it go 0.15 s before contact."""
    random, traces = np.random.default_rng(2), []
    for trace in lab.traces:
        since = np.concatenate([np.arange(-2250, 0) / 5e3 + trace.time_s[0], trace.time_s]) + 0.15
        value = 9.80665 * np.clip(1 - since / 0.002, 0, 1) + 0.1 * random.standard_normal(since.size)
        value += ring * (since > 0) * np.exp(-since / 0.01) * np.sin(2000 * since)
        value[2250:] += trace.value
        traces.append(Recorded(since - 0.15, value + offset))
    return replace(lab, traces=traces)


@pytest.mark.parametrize(
    ("gravity", "offset", "ring"), [(0.0, 3.0, 0.0), (9.80665, -9.80665, 0.0), (9.80665, 0.0, 5.0)]
)
def test_free_fall_after_a_held_mass_is_quiet(gravity, offset, ring):
    lab = record([Impact(39.0, 0.26, gravity=gravity)] * 5, 5e3, before=0.0, after=0.05, phase=PHASES[:5])
    dropped = held(lab, offset, ring)
    made = displacements(dropped)
    assert (made.flags, made.notes) == ([[]] * 5, [[]] * 5)
    assert np.abs(made.contact_time_s).max() < 1 / 5e3
    assert np.abs(made.quiet.offset - offset).max() < 0.1
    assert raised(inspect(dropped), 5) == [[]] * 5


def test_a_sound_recording_begins_where_it_began():
    whole = stack(record([Impact(67.0, 0.28)] * 5, 5e3, before=0.3, noise=0.005, offset=5.0).traces)
    assert since_release(whole) is whole


def test_few_samples_behind_a_drift_are_no_contact():
    lab = record([Impact(45.0, 0.28)], 200, before=0.1, after=0.2, noise=0.005)
    drifts = lab.changed(lambda time, value: (time, value + 40 * np.minimum(time, 0)))
    cut = displacements(drifts, SignalOptions(window=0.5))
    assert cut.flags == [[NO_CONTACT]]
    assert TOO_FEW in displacements(lab, SignalOptions(window=0.5)).flags[0]
