"""What is taken for a tap and for the ringing after it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bayestissue.dataset import Dataset, Trace
from bayestissue.signal import displacements
from bayestissue.signal.tapped import FEW_IN_TAP, NO_TAP, taps
from bayestissue.simulation import Simulation, simulate

K, C, MASS, IMPULSE, DURATION = 4000.0, 12.0, 2.0, 0.4, 0.006


def tapped(**recording: Any) -> tuple[Dataset, Any]:
    """One person's mass, tapped three times, and the truth."""
    force = {"place": "hammer", "noise_sd_N": 0.05} | recording.pop("force", {})
    content = {
        "name": "taps",
        "seed": 4,
        "design": {
            "subjects": 1,
            "repeats": 3,
            "conditions": [{"trial": "tap", "mass_kg": MASS, "impulse_N_s": IMPULSE}],
        },
        "tissue": {
            **{"K_N_per_m": K, "C_N_s_per_m": C, "reference_mass_kg": MASS},
            **{f"sd_{group}_{q}": 0.0 for group in ("subject", "trial", "impact") for q in "KC"},
        },
        "tap": {"duration_s": DURATION},
        "recording": {
            **{"sampling_rate_hz": 5000.0, "noise_sd_m_s2": 0.02, "offset_sd_m_s2": 0.5},
            **recording,
            "force": force,
        },
    }
    made = simulate(Simulation.model_validate(content))
    return made.dataset("taps"), made.truth


def test_the_tap_is_where_the_hammer_pushes() -> None:
    data, truth = tapped()
    found, interval = taps(data), 1 / 5000.0
    # Between the sample before the first above noise, and the one after the last: half a sine of 105 N stands
    # five times above 0.05 N, or at a hundredth of itself, within an interval of its ends.
    begin = truth["contact_time_s"].to_numpy()
    assert (np.abs(found.begin - begin) <= interval).all()
    assert (np.abs(found.begin + found.end - begin - DURATION) <= interval).all()
    assert (np.abs(found.impulse.sum(1) - IMPULSE) < 4 * found.impulse_sd).all()
    assert (np.abs(found.begin + found.middle - begin - DURATION / 2) < interval).all()
    assert not any(raised.any() for raised in found.flags.values())


def test_rows_are_means_of_the_samples_after_the_hammer() -> None:
    data, _ = tapped()
    found = taps(data)
    for i, trace in enumerate(data.traces):
        first = np.flatnonzero(trace.time_s > found.begin[i] + found.end[i])[0]
        count, n = int(found.averaged[i]), int(found.n_samples[i])
        d = -trace.value[first : first + count * n] - found.zero[i]
        assert found.ringing.value[i, :n] == pytest.approx(d.reshape(n, count).mean(1), abs=1e-9)
        middle = trace.time_s[first : first + count].mean()
        assert found.begin[i] + found.first_time[i] == pytest.approx(middle, abs=1e-9)
        # At least so many a period of (K / M)^1/2.
        assert 2 * np.pi / np.sqrt(K / MASS) / found.ringing.dt[i] >= 15


def test_the_ringing_ends_where_only_noise_is_left() -> None:
    data, _ = tapped()
    found = taps(data)
    until = found.first_time + found.n_samples * found.ringing.dt
    # The envelope V omega e^(-C t / 2 M), V = J / M, is as great as the noise at this time.
    envelope = IMPULSE / MASS * np.sqrt(K / MASS)
    quiet = np.log(envelope / 0.02) * 2 * MASS / C
    recorded = np.array([trace.time_s[-1] for trace in data.traces]) - found.begin
    assert (until > np.minimum(0.7 * quiet, 0.95 * recorded)).all()
    assert (until < np.minimum(2 * quiet, recorded + 1e-9)).all()


def test_a_hammer_that_bounces_has_tapped_once() -> None:
    data, _ = tapped()
    (channel,) = data.channels
    begin = taps(data).begin
    again = [
        Trace(one.time_s, one.value + np.interp(one.time_s - begin[i], [0.02, 0.022, 0.024], [0, 20, 0]))
        for i, one in enumerate(channel.traces)
    ]
    found = taps(replace(data, channels=[replace(channel, traces=again)]))
    assert found.end == pytest.approx(0.024, abs=2 / 5000)
    assert found.impulse.sum(1) == pytest.approx(IMPULSE + 20 * 0.002, rel=0.01)


def test_no_tap_and_a_rough_one_are_named() -> None:
    data, _ = tapped()
    (channel,) = data.channels
    rng = np.random.default_rng(0)
    silent = [Trace(one.time_s, 0.05 * rng.standard_normal(len(one.value))) for one in channel.traces]
    nothing = displacements(replace(data, channels=[replace(channel, traces=silent)]))
    assert all(NO_TAP in flags and FEW_IN_TAP not in flags for flags in nothing.flags)
    sparse = [Trace(one.time_s[::5], one.value[::5]) for one in channel.traces]
    rough = displacements(replace(data, channels=[replace(channel, traces=sparse)]))
    assert all(FEW_IN_TAP in flags for flags in rough.flags)


def test_displacements_are_those_of_the_acceleration() -> None:
    data, _ = tapped(noise_sd_m_s2=1e-9, offset_sd_m_s2=0.0)
    signal = displacements(data)
    omega_n, zeta = np.sqrt(K / MASS), C / (2 * np.sqrt(K * MASS))
    # The greatest depth after an impulse, of which a pulse of a twelfth of the period takes off one per cent.
    damped = np.sqrt(1 - zeta**2)
    deepest = IMPULSE / MASS / omega_n * np.exp(-zeta / damped * np.arccos(zeta))
    assert signal.peak_displacement == pytest.approx(deepest, rel=0.02)
    assert (signal.velocity == 0).all()
    assert (signal.contact_time_s == taps(data).begin).all()
