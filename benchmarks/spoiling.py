"""Ways in which a recording is spoilt, one function each, and what the checks and K and C make of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from sound import FINE_HZ, Chain, Impact, chain, dataset

from bayestissue.base.errors import Coded
from bayestissue.inference.single.impact_estimates import estimate
from bayestissue.recordings.dataset import Dataset, Trace
from bayestissue.recordings.dataset.dataset_file import Quantity
from bayestissue.recordings.dataset.formats.channel import Channel
from bayestissue.recordings.dataset.recording_checks import check_recordings
from bayestissue.recordings.dataset.recordings import Recordings

type Stage = Callable[[np.ndarray, np.ndarray], np.ndarray]
type Spoiling = Callable[[Impact, Chain, np.random.Generator], Trace]
GRAVITY = 9.80665


def record(
    impact: Impact,
    chain: Chain,
    *,
    quantity: Quantity = "deceleration",
    sensor: Stage | None = None,
    analogue: Stage | None = None,
    digital: Stage | None = None,
    jitter: float = 0.0,
) -> Trace:
    """What the recorder writes of an impact; time 0 is its first sample.

    Args:
        impact: the motion.
        chain: how it is recorded.
        quantity: "deceleration" or "displacement".
        sensor: what happens to the signal before noise is added, at `FINE_HZ`; given the time since contact
            [s] and the signal as a fraction of the peak.
        analogue: the same with the noise.
        digital: the same of the samples taken.
        jitter: by how much a sample is taken early or late at most, as a fraction of the sampling interval.
    """
    rng = np.random.default_rng(chain.seed)
    signal = impact.displacement if quantity == "displacement" else impact.deceleration
    peak = signal.max()
    since = np.arange(signal.size) / FINE_HZ - impact.contact
    # White on the fine grid, so that every sample taken has noise of its own.
    fine = signal / peak if sensor is None else sensor(since, signal / peak)
    fine = fine + chain.noise * rng.standard_normal(signal.size)
    if analogue is not None:
        fine = analogue(since, fine)
    taken = np.arange(chain.phase, signal.size, chain.every)
    begin = -chain.before if chain.before else 0.0
    taken = taken[(since[taken] >= begin) & (since[taken] <= chain.after)]
    late = rng.uniform(-jitter, jitter, taken.size) * chain.every
    samples = fine[np.clip(taken + np.round(late).astype(int), 0, signal.size - 1)]
    if digital is not None:
        samples = digital(since[taken], samples)
    samples = np.round(samples * chain.levels) / chain.levels
    return Trace(np.arange(samples.size) * chain.dt, peak * samples)


def clipped(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """Cut off by the recorder at 50 to 90 % of the peak."""
    limit = rng.uniform(0.5, 0.9)
    return record(impact, chain, digital=lambda _, d: np.minimum(d, limit))


def clipped_under_noise(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """Cut off by the sensor at 50 to 90 % of the peak, and noise added behind it."""
    limit = rng.uniform(0.5, 0.9)
    return record(impact, chain, sensor=lambda _, d: np.minimum(d, limit))


def late(impact: Impact, chain: Chain, rng: np.random.Generator, seconds: float) -> Trace:
    """The recording begins so long after contact."""
    whole = record(impact, replace(chain, before=0.0))
    lost = max(1, round(seconds / chain.dt))
    return Trace(np.arange(whole.value.size - lost) * chain.dt, whole.value[lost:])


def _spiked(trace: Trace, start: int, height: float, width: int) -> Trace:
    value = trace.value.copy()
    value[start : start + width] += height * value.max()
    return Trace(trace.time_s, value)


def spike_before(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """One to three samples before contact are 0.3 to 2 times the peak too high."""
    chain = _quiet(chain, rng)
    trace = record(impact, chain)
    start = rng.integers(1, max(2, int(chain.before / chain.dt) - 4))
    return _spiked(trace, int(start), rng.uniform(0.3, 2), int(rng.integers(1, 4)))


def spike_during(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """One to three samples during the impact are 0.3 to 2 times the peak too high, or too low."""
    trace = record(impact, chain)
    begin = int(chain.before / chain.dt)
    start = begin + rng.integers(2, int(impact.to_peak / chain.dt))
    height = rng.choice([-1, 1]) * rng.uniform(0.3, 2)
    return _spiked(trace, int(start), height, int(rng.integers(1, 4)))


def baseline_shift(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The sensor's zero moves during the impact by 3 to 15 % of the peak, in proportion to what it took."""
    chain = replace(_quiet(chain, rng), after=impact.leaves + rng.uniform(0.01, 0.035))
    shift = rng.choice([-1, 1]) * rng.uniform(0.03, 0.15)

    def moved(since: np.ndarray, d: np.ndarray) -> np.ndarray:
        taken = np.cumsum(np.where((since > 0) & (since < impact.leaves), np.maximum(d, 0), 0))
        return d + shift * taken / taken[-1]

    return record(impact, chain, digital=moved)


def hum(impact: Impact, chain: Chain, rng: np.random.Generator, hertz: float) -> Trace:
    """Mains hum, 2 to 15 % of the peak."""
    chain = replace(_quiet(chain, rng), after=impact.leaves + rng.uniform(0.01, 0.035))
    size, phase = rng.uniform(0.02, 0.15), rng.uniform(0, 2 * np.pi)
    return record(impact, chain, digital=lambda t, d: d + size * np.sin(2 * np.pi * hertz * t + phase))


def drift(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The zero drifts evenly, by 5 to 30 % of the peak between contact and zero velocity."""
    chain = _quiet(chain, rng)
    slope = rng.choice([-1, 1]) * rng.uniform(0.05, 0.3) / impact.to_peak
    return record(impact, chain, digital=lambda t, d: d + slope * t)


def dropped(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """5 to 25 % of the samples until zero velocity are lost in one piece, and the gap is closed."""
    trace = record(impact, chain)
    inside = int(impact.to_peak / chain.dt)
    lost = max(1, round(rng.uniform(0.05, 0.25) * inside))
    start = int(chain.before / chain.dt) + rng.integers(1, max(2, inside - lost))
    value = np.delete(trace.value, slice(start, start + lost))
    return Trace(trace.time_s[: value.size], value)


def held(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """Each sample is repeated: the channel is sampled at a half to an eighth of the recorder's rate."""
    times = int(rng.integers(2, 9))
    return record(impact, chain, digital=lambda _, d: d[(np.arange(d.size) // times) * times])


def stuck(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The channel stands still for 10 to 40 % of the time to zero velocity."""
    inside = int(impact.to_peak / chain.dt)
    count = max(3, round(rng.uniform(0.1, 0.4) * inside))
    start = int(chain.before / chain.dt) + rng.integers(1, max(2, inside - count))

    def still(_: np.ndarray, d: np.ndarray) -> np.ndarray:
        d = d.copy()
        d[start : start + count] = d[start]
        return d

    return record(impact, chain, digital=still)


def jittered(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """Samples are taken up to 45 % of an interval early or late, and declared even."""
    return record(impact, chain, jitter=0.45)


def wrong_rate(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The times are those of another sampling rate: a half, twice or ten times the true one."""
    trace = record(impact, chain)
    return Trace(trace.time_s * rng.choice([0.1, 0.5, 2.0, 10.0]), trace.value)


def flipped(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The sign is the other one."""
    trace = record(impact, chain)
    return Trace(trace.time_s, -trace.value)


def wrong_unit(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """Values in g are taken for m/s², or the other way round."""
    trace = record(impact, chain)
    return Trace(trace.time_s, trace.value * rng.choice([GRAVITY, 1 / GRAVITY]))


def second_hit(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """Something else is hit before zero velocity: a bump of 0.3 to 1 times the peak, a third as long."""
    at, size = rng.uniform(0.3, 0.9) * impact.to_peak, rng.uniform(0.3, 1)
    width = impact.to_peak / 3

    def bump(t: np.ndarray, d: np.ndarray) -> np.ndarray:
        return d + size * np.where(np.abs(t - at) < width / 2, np.cos(np.pi * (t - at) / width), 0) ** 2

    return record(impact, chain, digital=bump)


def coarse(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """A range so wide that 3 to 12 steps of the recorder cover the peak."""
    return record(impact, replace(chain, levels=int(rng.integers(3, 13))))


def slow_filter(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """An undeclared low-pass of the second order between sensor and recorder, 30 to 150 Hz."""
    from scipy.signal import butter, sosfilt

    # The sensor's noise passes through it too: as much as the chain has after it.
    sections = butter(2, rng.uniform(30, 150), fs=FINE_HZ, output="sos")
    return record(impact, chain, analogue=lambda _, d: sosfilt(sections, d))


def offset(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The sensor's zero is off by 5 to 20 % of the peak, and the recording has no quiet part."""
    chain = replace(chain, before=3 * chain.dt)
    size = rng.choice([-1, 1]) * rng.uniform(0.05, 0.2)
    return record(impact, chain, digital=lambda _, d: d + size)


def ends_early(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The recording ends before zero velocity, at 40 to 85 % of the time to it."""
    return record(impact, replace(chain, after=impact.to_peak * rng.uniform(0.4, 0.85)))


def gain_step(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """The amplifier changes its gain during the impact, by a factor of 0.5 to 0.85 or 1.2 to 2."""
    at = rng.uniform(0.2, 0.9) * impact.to_peak
    factor = rng.choice([rng.uniform(0.5, 0.85), rng.uniform(1.2, 2)])
    return record(impact, chain, digital=lambda t, d: np.where(t > at, factor * d, d))


def deep_displacement(impact: Impact, chain: Chain, rng: np.random.Generator) -> Trace:
    """A recorded displacement that begins at 5 to 30 % of its peak."""
    chain = replace(chain, before=0.0)
    whole = record(impact, chain, quantity="displacement")
    first = int(np.argmax(whole.value > rng.uniform(0.05, 0.3) * whole.value.max()))
    return Trace(whole.time_s[: whole.value.size - first], whole.value[first:])


def _quiet(chain: Chain, rng: np.random.Generator) -> Chain:
    return chain if chain.before > 0.005 else replace(chain, before=float(rng.uniform(0.01, 0.035)))


KINDS: dict[str, Spoiling] = {
    "clipped": clipped,
    "clipped, noise behind it": clipped_under_noise,
    "begins 1 ms late": partial(late, seconds=0.001),
    "begins 2 ms late": partial(late, seconds=0.002),
    "begins 4 ms late": partial(late, seconds=0.004),
    "spike before contact": spike_before,
    "spike during the impact": spike_during,
    "zero moves during the impact": baseline_shift,
    "hum of 50 Hz": partial(hum, hertz=50.0),
    "hum of 60 Hz": partial(hum, hertz=60.0),
    "drift": drift,
    "samples lost": dropped,
    "samples repeated": held,
    "channel stands still": stuck,
    "uneven times declared even": jittered,
    "another sampling rate": wrong_rate,
    "other sign": flipped,
    "g for m/s² or back": wrong_unit,
    "second hit": second_hit,
    "coarse steps": coarse,
    "slow low-pass": slow_filter,
    "offset, no quiet part": offset,
    "ends before zero velocity": ends_early,
    "gain changes": gain_step,
    "displacement begins deep": deep_displacement,
}
DISPLACEMENT = ("displacement begins deep",)


@dataclass(frozen=True)
class Recorded:
    """Recordings and the chains that made them, of one quantity, side by side."""

    impacts: list[Impact]
    chains: list[Chain]
    traces: list[Trace]
    quantity: Quantity = "deceleration"

    def __add__(self, more: Recorded) -> Recorded:
        own, other = ((each.impacts, each.chains, each.traces) for each in (self, more))
        return Recorded(*(a + b for a, b in zip(own, other, strict=True)), self.quantity)  # type: ignore[call-arg]


def sound_ones(
    impacts: list[Impact],
    count: int,
    quantity: Quantity = "deceleration",
    seed: int = 0,
    *,
    cropped: bool = False,
) -> Recorded:
    """``count`` of the impacts in sound recordings, all ``cropped`` at contact or not."""
    rng = np.random.default_rng([seed, len(KINDS) + (quantity == "displacement")])
    chosen, chains = _drawn(impacts, count, rng, quantity)
    if cropped:
        chains = [replace(way, before=0.0) for way in chains]
    return Recorded(chosen, chains, _sound(chosen, chains, quantity), quantity)


def spoilt_ones(kind: str, impacts: list[Impact], count: int, seed: int = 0) -> Recorded:
    """``count`` of the impacts, spoilt in one of the ways of `KINDS`."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    quantity: Quantity = "displacement" if kind in DISPLACEMENT else "deceleration"
    chosen, chains = _drawn(impacts, count, rng, quantity)
    traces = [KINDS[kind](impact, way, rng) for impact, way in zip(chosen, chains, strict=True)]
    return Recorded(chosen, chains, traces, quantity)


def judged(recorded: Recorded, *, sound: bool = False) -> pd.DataFrame:
    """What is said of recordings, and how far their K and C are off.

    Args:
        recorded: the recordings.
        sound: that nothing has spoilt them, so that nothing is off.

    Returns:
        One row per impact: ``flags``, what `check` refuses or warns of or point estimates flag, joined by
        "; ": whether the element is the tissue's is not asked; ``K_off`` and ``C_off``, how far `estimate` is
        from what it has of the same impact recorded with the same chain and noise and not spoilt, as
        fractions (infinite where there is none); ``off``, the greater; ``noted``, whether a note says that
        contact may have come earlier.
    """
    data = dataset(recorded.impacts, recorded.traces, recorded.quantity)
    table = estimate(data, method="dds")
    noted = table["notes"].str.contains(Coded.stated("contact-earlier"), regex=False)
    found = pd.DataFrame({"flags": _said(data, table), "K_off": 0.0, "C_off": 0.0, "noted": noted})
    if not sound:
        whole = _sound(recorded.impacts, recorded.chains, recorded.quantity)
        now, reference = estimate(data), estimate(dataset(recorded.impacts, whole, recorded.quantity))
        for name, column in (("K_off", "K_N_per_m"), ("C_off", "C_N_s_per_m")):
            found[name] = np.abs(now[column] / reference[column] - 1).fillna(np.inf)
    return found.assign(off=found[["K_off", "C_off"]].max(axis=1))


def _drawn(
    impacts: list[Impact], count: int, rng: np.random.Generator, quantity: Quantity
) -> tuple[list[Impact], list[Chain]]:
    chosen = [impacts[index] for index in rng.choice(len(impacts), count, replace=count > len(impacts))]
    chains = [chain(impact, rng) for impact in chosen]
    if quantity == "displacement":
        # A point estimate from a displacement with more noise than that is of no use.
        chains = [replace(way, noise=way.noise / 40) for way in chains]
    return chosen, chains


def _sound(impacts: list[Impact], chains: list[Chain], quantity: Quantity) -> list[Trace]:
    return [record(impact, way, quantity=quantity) for impact, way in zip(impacts, chains, strict=True)]


def _said(data: Dataset, table: pd.DataFrame) -> pd.Series:
    flat = data.traces
    read = Channel(flat.value, flat.time_s, rows=np.arange(flat.value.size) + 2)
    how = data.settings, data.settings.signal, data.impacts, "traces.csv"
    verdicts = check_recordings(Recordings.from_channel(read, flat.n_samples, *how))
    refused = pd.Series("", index=data.impacts["impact"])
    for problem in (*verdicts.warnings, *verdicts.problems):
        refused[problem.impact or ""] = f"refused or warned of: not {problem.expected.split(':')[0]}"
    return refused.reset_index(drop=True).where(lambda said: said != "", table["flags"])
