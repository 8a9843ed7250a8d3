"""Sound recordings of very different impacts pass; the same recordings spoilt do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from bayestissue.recordings.dataset.dataset_file import Quantity, Settings, SignalSettings
from bayestissue.recordings.dataset.formats.channel import Channel
from bayestissue.recordings.dataset.ragged_traces import Traces, at_limit
from bayestissue.recordings.dataset.recording_checks import check_recordings
from bayestissue.recordings.dataset.recordings import Recordings

COUNT = 100


@dataclass(frozen=True)
class Blow:
    mass: float
    velocity: float
    time: np.ndarray
    x: np.ndarray
    deceleration: np.ndarray
    step: float


def blow(rng: np.random.Generator) -> Blow:
    """A spring and damper (damping ratio 0.02 to 2), 12 to 1000 samples until zero velocity, any recorder."""
    mass, stiffness = 10 ** rng.uniform(-0.7, 1), 10 ** rng.uniform(2.7, 4.7)
    ratio, velocity = 10 ** rng.uniform(-1.7, 0.3), 10 ** rng.uniform(-0.7, 0.7)
    frequency = np.sqrt(stiffness / mass)
    one, two = np.roots([1, 2 * ratio * frequency, frequency**2]).astype(complex)
    # x' = 0 where exp((one - two) t) = two / one.
    to_peak = float((np.log(two / one) / (one - two)).real)
    interval = to_peak / 10 ** rng.uniform(1.1, 3)
    before = rng.choice([0, rng.uniform(0, 3)]) * to_peak
    after = rng.choice([1, rng.uniform(1, 6)]) * to_peak
    time = np.arange(-before + rng.uniform(0, interval), after + interval, interval)
    since = np.maximum(time, 0)
    scale = velocity / (one - two)
    x = (scale * (np.exp(one * since) - np.exp(two * since))).real
    v = (scale * (one * np.exp(one * since) - two * np.exp(two * since))).real
    d = np.where(time >= 0, np.maximum(frequency**2 * x + 2 * ratio * frequency * v, 0), 0)
    d[np.cumsum((time > to_peak) & (d <= 0)) > 0] = 0
    peak = d.max()
    d = d + peak * (
        rng.choice([0, 10 ** rng.uniform(-3.5, -1.3)]) * rng.standard_normal(d.size)
        + rng.choice([0, rng.uniform(-0.02, 0.02)])
    )
    step = 2 * peak * rng.uniform(1.2, 4) / 2 ** rng.integers(8, 25)
    return Blow(mass, velocity, time, x, step * np.round(d / step), step)


@pytest.fixture(scope="module")
def blows() -> list[Blow]:
    rng = np.random.default_rng(20)
    return [blow(rng) for _ in range(COUNT)]


Change = Callable[[Blow], np.ndarray]


def whole(b: Blow) -> np.ndarray:
    return np.ones(b.time.size, dtype=bool)


def samples_of(blows: list[Blow], value: Change, keep: Change = whole) -> Traces:
    kept = [keep(b) for b in blows]
    time = [b.time[k] for b, k in zip(blows, kept, strict=True)]
    values = np.concatenate([value(b)[k] for b, k in zip(blows, kept, strict=True)])
    return Traces(np.concatenate(time), values, np.cumsum([0, *map(len, time)]))


def refused(
    blows: list[Blow], value: Change, keep: Change = whole, quantity: Quantity = "deceleration"
) -> int:
    """How many of the recordings, spoilt by ``value`` and cut down to ``keep``, are refused."""
    names = [f"i{index}" for index in range(COUNT)]
    impacts = pd.DataFrame({"impact": names, "velocity_m_s": [b.velocity for b in blows]})
    signal = SignalSettings(quantity=quantity, unit="m" if quantity == "displacement" else "m/s^2")
    samples = samples_of(blows, value, keep)
    read = Channel(samples.value, samples.time_s, rows=np.arange(samples.value.size) + 2)
    how = Settings(name="a", signal=signal), signal, impacts, "traces.csv"
    recordings = Recordings.from_channel(read, samples.n_samples, *how)
    return len({problem.impact for problem in check_recordings(recordings).problems})


def test_sound_recordings_pass(blows: list[Blow]) -> None:
    assert refused(blows, lambda b: b.deceleration) == 0
    assert refused(blows, lambda b: -b.deceleration, quantity="acceleration") == 0
    assert refused(blows, lambda b: b.x, quantity="displacement") == 0


def left_again(impact: Blow) -> np.ndarray:
    """The displacement up to its peak, and then out three times as far as it went in."""
    top = int(impact.x.argmax())
    way_out = np.linspace(impact.x[top], -3 * impact.x[top], impact.x.size - top)
    return np.concatenate([impact.x[:top], way_out])


@pytest.mark.slow
def test_an_impactor_may_leave_farther_than_it_came(blows: list[Blow]) -> None:
    assert refused(blows, left_again, quantity="displacement") == 0
    assert refused(blows, lambda b: -left_again(b), quantity="displacement") == COUNT


def test_a_wrong_sign_never_passes(blows: list[Blow]) -> None:
    assert refused(blows, lambda b: -b.deceleration) == COUNT
    assert refused(blows, lambda b: b.deceleration, quantity="acceleration") == COUNT
    assert refused(blows, lambda b: -b.x, quantity="displacement") == COUNT


@pytest.mark.parametrize("factor", [9.80665, 1 / 9.80665])
def test_a_wrong_unit_never_passes(factor: float, blows: list[Blow]) -> None:
    assert refused(blows, lambda b: factor * b.deceleration) == COUNT


def test_a_recording_that_ends_at_half_the_speed_never_passes(blows: list[Blow]) -> None:
    def first_half(b: Blow) -> np.ndarray:
        lost = np.cumsum(b.deceleration * (b.time >= 0)) * (b.time[1] - b.time[0])
        return lost < 0.5 * b.velocity

    assert refused(blows, lambda b: b.deceleration, first_half) == COUNT


def test_clipping_at_nine_tenths_is_seen(blows: list[Blow]) -> None:
    def clipped(b: Blow) -> np.ndarray:
        return np.minimum(b.deceleration, b.step * np.floor(0.9 * b.deceleration.max() / b.step))

    samples = samples_of(blows, clipped)
    seen = np.add.reduceat((at_limit(samples, "deceleration") > 0).astype(int), samples.begin) > 0
    # Fewer than four samples above the limit, or steps as coarse as the slope, leave nothing to see.
    assert seen.sum() > 0.8 * COUNT


def test_sound_recordings_meet_no_limit(blows: list[Blow]) -> None:
    assert not at_limit(samples_of(blows, lambda b: b.deceleration), "deceleration").any()
