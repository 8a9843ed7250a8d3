"""Several impacts in one recording, cut apart."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from bayestissue.recordings.dataset import Trace
from bayestissue.recordings.intake.build import blow_again, cut

RATE, LENGTH_S = 2000.0, 0.05


def recording(at: list[float], height: list[float], noise: float, seed: int = 0) -> Trace:
    """Half sines of 50 ms that begin ``at`` these times, on white noise and a wander three times as high."""
    time = np.arange(int(6 * RATE)) / RATE - 1.0
    value = np.random.default_rng(seed).normal(0, noise, time.size) + 3 * noise * np.sin(2 * np.pi * time / 4)
    for start, high in zip(at, height, strict=True):
        inside = (time >= start) & (time < start + LENGTH_S)
        value[inside] += high * np.sin(np.pi * (time[inside] - start) / LENGTH_S)
    return Trace(time, value)


@pytest.mark.parametrize("seed", range(2))
def test_every_impact_has_its_stretch(seed: int) -> None:
    at, height = [0.1, 1.2, 2.0, 4.4], [100.0, 40.0, 25.0, 90.0]
    stretches = cut(recording(at, height, 0.2, seed=seed))
    assert len(stretches) == len(at)
    for start, (begin, end) in zip(at, stretches, strict=True):
        # A tenth and a half of the separation of 0.5 s, from the samples that rise above a tenth of the peak.
        assert start - 0.05 <= begin <= start - 0.03
        assert start + LENGTH_S + 0.23 <= end <= start + LENGTH_S + 0.25
    assert all(end < begin for (_, end), (begin, _) in pairwise(stretches))


def test_a_rebound_stays_with_its_impact() -> None:
    trace = recording([0.1, 0.4, 2.0], [100.0, 30.0, 80.0], 0.2)
    assert len(cut(trace)) == 2
    assert len(cut(trace, separation_s=0.2)) == 3


def test_the_threshold_counts_in_standard_deviations_of_the_noise() -> None:
    # The scatter about the median of noise 1 with this wander is about 2.4.
    trace = recording([0.1, 2.0], [200.0, 40.0], 1.0)
    assert len(cut(trace, threshold=10)) == 2
    assert len(cut(trace, threshold=30)) == 1


def test_nothing_but_noise_has_no_impact() -> None:
    assert cut(recording([], [], 1.0)) == []
    assert cut(Trace(np.arange(3.0), np.ones(3))) == []
    assert cut(Trace(np.arange(20.0), np.full(20, np.nan))) == []
    assert cut(Trace(np.arange(20.0), np.ones(20))) == []


@pytest.mark.parametrize("apart", [0.16, 0.3])
def test_another_impact_that_soon_follows_is_said(apart: float) -> None:
    for heights in ([100.0, 90.0], [60.0, 100.0]):
        trace = recording([0.1, 0.1 + apart], heights, 0.2)
        assert len(cut(trace)) == 1
        found = blow_again(trace)
        assert found is not None
        # Of a half sine the noise moves the highest sample by some of its 100.
        assert abs(found - apart) < 0.01
        assert len(cut(trace, separation_s=float(f"{found / 2:.1g}"))) == 2


def test_a_flat_top_is_one_blow() -> None:
    """Which some of its samples alone lie more than twenty standard deviations of the noise above."""
    value = np.random.default_rng(0).normal(0, 3.0, 1500)
    value[200:500] += np.interp(np.arange(300), [0, 20, 280, 300], [0, 80, 80, 0])
    assert blow_again(Trace(np.arange(1500) / RATE, value)) is None


def test_rebounds_and_swings_are_not() -> None:
    assert blow_again(recording([0.1], [100.0], 0.2)) is None
    assert blow_again(recording([0.1, 0.3], [100.0, 45.0], 0.2)) is None
    # A tissue that swings: half sines a contact apart.
    assert blow_again(recording([0.1, 0.2, 0.3], [100.0, 80.0, 60.0], 0.2)) is None
    assert blow_again(recording([], [], 1.0)) is None
    assert blow_again(Trace(np.arange(3.0), np.ones(3))) is None
