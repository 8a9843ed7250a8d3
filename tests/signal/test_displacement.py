from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from impacts_bench import Impact, Lab, Recorded, record

from bayestissue.recordings.signal import SignalOptions, displacement, displacements
from bayestissue.recordings.signal.signal_settings import WindowSettings

TISSUE = [Impact(np.sqrt(3000 / mass), zeta) for mass in (0.1, 0.666, 5.0) for zeta in (0.02, 0.28, 1.0, 2.0)]
TYPICAL = Impact(67.0, 0.28)


@pytest.mark.parametrize("gravity", [0.0, 9.80665])
@pytest.mark.parametrize("rate", [2e3, 5e4])
@pytest.mark.parametrize("before", [0.0, 0.01])
def test_noise_free_displacements_are_those_of_the_motion(rate, before, gravity):
    phases = np.linspace(0, 0.95, 5) if before else np.zeros(1)
    impacts = [replace(impact, gravity=gravity) for impact in TISSUE for _ in phases]
    made = displacements(record(impacts, rate, before=before, phase=np.tile(phases, len(TISSUE))))
    for row, impact in enumerate(impacts):
        n = made.n_samples[row]
        time = made.contact.since_s[row] + np.arange(n) / rate
        peak = float(impact.derivative(0, np.array(impact.time_to_peak)))
        fastest = max(abs(root) for root in impact.roots) / rate
        # The quadrature's error is of the sixth order in interval times pole; where that product is small
        # what is left is the contact time, which least squares finds to the square root of rounding error.
        # At both ends of a record the rule is one-sided, with a constant some twenty times the central one.
        tolerance = 0.3 * fastest**6 + 1e-5
        assert np.abs(made.x[row, :n] - impact.derivative(0, time)).max() < tolerance * peak
        assert np.abs(made.v[row, :n] - impact.derivative(1, time)).max() < 4 * tolerance * impact.velocity
        assert made.stop.x[row] == pytest.approx(peak, rel=tolerance)
        assert made.time_to_peak[row] == pytest.approx(impact.time_to_peak, rel=4 * tolerance)
        assert abs(made.contact_time_s[row]) * rate < 10 * tolerance
        assert time[-1] <= impact.time_to_peak < time[-1] + 1.01 / rate


def test_the_thesis_rule_keeps_its_error_and_the_default_has_none():
    lab = record([TYPICAL], 2e3)
    peak = float(TYPICAL.derivative(0, np.array(TYPICAL.time_to_peak)))
    errors = [abs(displacements(lab, rule=rule).stop.x[0] / peak - 1) for rule in ("trapezoidal", "quintic")]
    # (omega dt)²/12 is 9e-5 here.
    assert 1e-5 < errors[0] < 1e-3
    assert errors[1] < 1e-6


def test_a_negative_acceleration_is_a_deceleration():
    lab = record([TYPICAL], 1e4, noise=0.005, offset=2.0)
    turned = Lab(lab.impacts, [Recorded(t.time_s, -t.value) for t in lab.traces], "acceleration")
    np.testing.assert_array_equal(displacements(lab).x, displacements(turned).x)


def test_the_offset_of_the_quiet_part_is_removed():
    lab = record([TYPICAL] * 50, 1e4, before=0.02, noise=0.005, offset=5.0)
    made = displacements(lab)
    sd = 0.005 * max(trace.value.max() - 5 for trace in lab.traces)
    # The mean of 200 quiet samples; five standard errors hold for 50 of them.
    assert np.abs(made.quiet.offset - 5).max() < 5 * sd / np.sqrt(195)
    assert np.median(made.quiet.noise_sd) == pytest.approx(sd, rel=0.1)


@pytest.mark.parametrize("samples", [8, 21])
def test_the_offset_errs_by_what_is_said_of_it(samples):
    number = 1_000
    made = displacements(record([TYPICAL] * number, 1e4, before=samples / 1e4, noise=0.005))
    told = made.quiet.there
    assert told.mean() > 0.95
    # Four standard errors of the standard deviation of Student's t of twenty samples.
    assert (made.quiet.offset / made.quiet.offset_sd)[told].std() == pytest.approx(
        1, abs=4 / np.sqrt(1.6 * number)
    )


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_a_window_can_end_before_zero_velocity(share):
    whole = displacements(record([TYPICAL], 1e4))
    part = displacements(record([TYPICAL], 1e4), SignalOptions(window=share))
    n = part.n_samples[0]
    assert n == np.floor(share * TYPICAL.time_to_peak * 1e4 + 1e-6) + 1
    np.testing.assert_array_equal(part.x[0, :n], whole.x[0, :n])
    assert part.time_to_peak[0] == whole.time_to_peak[0]


def test_a_missing_stop_is_flagged():
    cut = record([TYPICAL], 1e4)
    keep = cut.traces[0].time_s < TYPICAL.time_to_peak / 2
    cut.traces[0] = Recorded(cut.traces[0].time_s[keep], cut.traces[0].value[keep])
    assert "velocity does not reach zero" in displacements(cut).flags[0]


def test_impacts_of_unequal_length_and_in_blocks_give_what_each_gives_alone(monkeypatch):
    impacts = [Impact(40.0, 0.2), Impact(150.0, 0.7), Impact(67.0, 1.3)]
    # Where contact falls is told by all of them; all else each tells alone.
    lab = replace(record(impacts, 1e4, noise=0.005), contact="between")
    together = displacements(lab)
    monkeypatch.setattr(displacement, "WINDOW", WindowSettings(block=1))
    blocks = displacements(lab)
    for row, n in enumerate(together.n_samples):
        alone = displacements(Lab(lab.impacts.iloc[[row]], [lab.traces[row]], contact="between"))
        assert alone.n_samples[0] == n
        # The sums of the same numbers, padded with zeros to another length: rounding only.
        np.testing.assert_allclose(alone.x[0, :n], together.x[row, :n], rtol=1e-9, atol=1e-15)
        np.testing.assert_array_equal(alone.x[0, :n], blocks.x[row, :n])
        assert (together.x[row, n:] == 0).all()


def test_some_impacts_are_those_alone():
    """Of five too, which is as many as a phase has items."""
    whole = displacements(record([TYPICAL] * 5, 1e4, noise=0.005))
    part = whole.impacts(np.array([4, 1, 1]))
    np.testing.assert_array_equal(part.x, whole.x[[4, 1, 1]])
    np.testing.assert_array_equal(part.contact.sd, whole.contact.sd[[4, 1, 1]])
    assert part.notes == [whole.notes[row] for row in (4, 1, 1)]
    assert part.phase == whole.phase


ODD = {
    "zeros": np.zeros(100),
    "a constant": np.full(100, 5.0),
    "negative": -np.ones(50),
    "two samples": np.array([1.0, 2.0]),
    "five samples": np.array([0.0, 1.0, 2.0, 3.0, 1.0]),
    "noise": np.random.default_rng(0).standard_normal(300),
    "a spike": np.r_[np.zeros(50), 100.0, np.zeros(50)],
    "a step": np.r_[np.zeros(50), np.full(50, 100.0)],
    "huge": np.r_[np.zeros(20), 1e12 * np.hanning(50)],
    "tiny": np.r_[np.zeros(20), 1e-9 * np.hanning(50)],
    "stairs": 50 * np.repeat(np.random.default_rng(1).standard_normal(20), 10),
}


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["deceleration", "acceleration", "displacement"])
@pytest.mark.parametrize("choices", [{}, {"contact": "threshold"}, {"window": "rebound"}])
def test_odd_recordings_give_finite_numbers_and_no_warning(quantity, choices):
    for value in (*([value] for value in ODD.values()), list(ODD.values())):
        traces = [Recorded(np.arange(len(row)) * 1e-4, row) for row in value]
        table = pd.DataFrame({"mass_kg": 1.0, "velocity_m_s": np.full(len(traces), 1.5)})
        made = displacements(Lab(table, traces, quantity), SignalOptions(**choices))
        motion = made.x, made.v, made.time_to_peak, made.stop.x, made.contact_time_s, made.quiet.noise_sd
        assert all(np.isfinite(numbers).all() for numbers in motion)


def recorded_displacements(rate: float, noise: float, seed: int = 0) -> Lab:
    random = np.random.default_rng(seed)
    time = np.arange(-0.02, 0.06, 1 / rate) + 0.3 / rate
    path = np.where(time < 0, TYPICAL.velocity * time, TYPICAL.derivative(0, np.maximum(time, 0)))
    value = path + noise * random.standard_normal(len(time))
    table = pd.DataFrame({"mass_kg": [1.0], "velocity_m_s": [np.nan]})
    return Lab(table, [Recorded(time, value)], "displacement")


def test_a_recorded_displacement_is_taken_as_it_is():
    made = displacements(recorded_displacements(1e4, 0.0))
    n = made.n_samples[0]
    time = made.contact.since_s[0] + np.arange(n) / 1e4
    # Contact is interpolated on a line: the curvature over one interval is C V / M dt²/8 = 7e-8 m.
    np.testing.assert_allclose(made.x[0, :n], TYPICAL.derivative(0, time), atol=1e-7)
    assert abs(made.contact_time_s[0]) < 1e-7
    assert made.time_to_peak[0] == pytest.approx(TYPICAL.time_to_peak, rel=0.01)
    # Parabolas over 5 ms straddle the jump of deceleration: the missing V is a few per cent low.
    assert made.velocity[0] == pytest.approx(TYPICAL.velocity, rel=0.05)


def test_noise_of_a_marker_hardly_ever_ends_a_window():
    """2 mm, where the motion is 15 mm deep: by the slope of five samples 18 of 40 windows ended too early."""
    ends = [displacements(recorded_displacements(1e3, 2e-3, seed)).time_to_peak[0] for seed in range(40)]
    assert (np.array(ends) < 0.6 * TYPICAL.time_to_peak).sum() <= 2


def test_a_window_ends_with_the_force_where_noise_keeps_the_velocity_above_zero():
    """A mass on a strong damper comes back with less velocity than is lost in the noise."""
    lab = record([Impact(60.0, 4.0)] * 40, 5e3, before=0.02, after=0.05, noise=1e-3, phase=0.5)
    made = displacements(lab)
    last = made.contact.since_s + (made.n_samples - 1) * made.dt
    # The force ends at twice the time to zero velocity.
    assert (last < 2 * Impact(60.0, 4.0).time_to_peak).all()
    assert not any("velocity does not reach zero" in flags for flags in made.flags)
