"""What is wrong with samples, whatever the tissue.

Single ones: spikes, values that stand still, steps too coarse. While nothing is touched: drift, hum, a zero
that moves, slow noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import fdtrc, ndtri, stdtr

from bayestissue.recordings.dataset.ragged_traces import LIMITS, recorder_step
from bayestissue.recordings.signal.padded_traces import (
    Column,
    Index,
    Mask,
    PaddedTraces,
    Rows,
    at,
    first_where,
    last_where,
    noise_sd,
    samples_before,
    segment_moments,
)
from bayestissue.recordings.signal.signal_settings import PULSE, SAMPLES


@dataclass(frozen=True)
class PulseAndRests(PaddedTraces):
    """Recordings, their offset included, with what is known before any tissue is assumed.

    Attributes:
        peak: [impact], the greatest value above the median of the rest before contact, or above 0.
        top: [impact], where it is.
        sd: [impact], standard deviation of the noise, that of rounding to the recorder's steps included.
        step: [impact], the recorder's step.
        before, after: [impact, sample], the samples surely at rest before contact and after it.
    """

    peak: Column = field(kw_only=True)
    top: Index = field(kw_only=True)
    sd: Column = field(kw_only=True)
    step: Column = field(kw_only=True)
    before: Mask = field(kw_only=True)
    after: Mask = field(kw_only=True)

    @property
    def freedom(self) -> Column:
        """Degrees of freedom of ``sd``, about."""
        return np.maximum(PULSE.worth * self.inside.sum(axis=1), 1)

    @classmethod
    def from_recordings(cls, recordings: PaddedTraces) -> PulseAndRests:
        """Find pulse and rests by a running median, whatever the noise and whatever stands beside it."""
        value, inside = recordings.value, recordings.inside
        smooth = median_filter(recordings.held, (1, PULSE.median), mode="nearest")
        smooth = np.where(inside, smooth, -np.inf)
        top = np.argmax(smooth, axis=1)
        index = np.arange(value.shape[1])
        level = _quiet_level(value, smooth, top)
        peak = at(smooth, top) - level
        low = smooth <= (level + PULSE.low * peak)[:, None]
        rises = last_where(low & (index < top[:, None]))
        falls = first_where(low & (index > top[:, None]), recordings.n_samples)
        foot = rises - np.ceil(PULSE.foot * (top - rises)).astype(int) - 2
        tail = falls + np.ceil(PULSE.tail * (falls - top)).astype(int) + 2
        rows = [row[:n] for row, n in zip(value, recordings.n_samples, strict=True)]
        step = np.array([recorder_step(row, LIMITS.same * np.ptp(row)) for row in rows])
        sd = np.hypot(noise_sd(recordings), np.where(np.isfinite(step), step, 0) / np.sqrt(12))
        return cls(
            **vars(recordings),
            peak=peak,
            top=top,
            sd=np.maximum(sd, 1e-6 * np.abs(peak) + 1e-300),
            step=step,
            before=inside & (index <= foot[:, None]),
            after=inside & (index >= tail[:, None]),
        )


def _quiet_level(value: Rows, smooth: Rows, top: Index) -> Column:
    # Twice: the level at rest tells where the rest ends.
    level = np.zeros(len(value))
    index = np.arange(value.shape[1])
    for _ in range(2):
        half = level + 0.5 * (at(smooth, top) - level)
        rises = last_where((smooth <= half[:, None]) & (index < top[:, None]))
        end = rises - (top - rises) - 2
        early = np.where(index <= end[:, None], value, np.nan)
        known = end >= 4
        early[~known] = 0.0
        level = np.where(known, np.nanmedian(early, axis=1), 0.0)
    return level


def chance(squares: Column | float, count: Index | int, freedom: Column | float) -> Column:
    """The probability that noise alone leaves as much: an F test.

    Args:
        squares: the sum of what is left, squared, in the noise's variance.
        count: degrees of freedom that it has.
        freedom: those by which the variance is known.
    """
    return np.asarray(fdtrc(count, freedom, squares / count))


def spikes(recorded: PulseAndRests) -> Index:
    """The first sample of the highest spike of one to three samples; -1 where there is none.

    The straight lines through the four samples on either side both miss it, in the same direction, by more
    than noise does in a thousandth of all recordings and by a tenth of the peak; a cubic through all eight
    misses it too, which a pulse of few samples does not, nor a quintic one of very few. A force that jumps at
    contact and decays at once, as a strong damper's, is missed by the line behind it, and not by an
    exponential.
    """
    value, width = recorded.value, recorded.value.shape[1]
    best, spike, side = np.zeros(len(value)), np.full(len(value), -1), SAMPLES.side
    level = segment_moments(value, recorded.before.sum(axis=1))[0][:, None]
    pulse = recorded.inside & (value - level > SAMPLES.high * recorded.peak[:, None])
    short = pulse.sum(axis=1, keepdims=True) < SAMPLES.short
    for wide in range(1, SAMPLES.widest + 1):
        window = 2 * side + wide
        if width < window:
            break
        offsets = np.concatenate([np.arange(side), np.arange(side) + side + wide])
        t = offsets - (window - 1) / 2
        views = np.lib.stride_tricks.sliding_window_view(value, window, axis=1)
        at_spike = views[..., side : side + wide].mean(axis=-1)
        behind, both = views[..., side + wide :], views[..., offsets]
        parts = ((views[..., :side], t[:side], 1), (behind, t[side:], 1), (both, t, 3), (both, t, 5))
        weights = [_predicting(times, degree) for _, times, degree in parts]
        misses = [at_spike - part @ weight for (part, *_), weight in zip(parts, weights, strict=True)]
        misses[3] = np.where(short, misses[3], misses[2])
        jumps = np.abs(misses[0]) > SAMPLES.jump * np.abs(misses[1])
        decayed = at_spike - _decaying(level, behind, wide)
        toward = np.sign(misses[0])
        misses[1] = np.where(jumps, toward * np.minimum(toward * misses[1], toward * decayed), misses[1])
        same = np.all([toward == np.sign(miss) for miss in misses[1:]], axis=0)
        least = np.where(same, np.min(np.abs(misses), axis=0), 0.0)
        chance = -ndtri(SAMPLES.alarms / 2 / SAMPLES.widest / np.maximum(recorded.inside.sum(axis=1), 1))
        squares = [float(w @ w) for w in weights]
        square = np.where(short[:, 0], max(squares), max(squares[:3]))
        error = recorded.sd * np.sqrt(1 / wide + square)
        limit = np.maximum(chance * error, SAMPLES.high * recorded.peak)
        least = np.where(recorded.inside[:, window - 1 :], least, 0.0)
        highest = least.max(axis=1)
        here = np.argmax(least, axis=1) + side
        better = (highest > limit) & (highest > best)
        best, spike = np.where(better, highest, best), np.where(better, here, spike)
    return spike


def _decaying(level: np.ndarray, behind: np.ndarray, wide: int) -> np.ndarray:
    """What a decay to ``level`` was, on average, over ``wide`` samples before those of ``behind``.

    Its rate is that of the halves of ``behind``.
    """
    halves, side = [part.mean(axis=-1) - level for part in np.split(behind, 2, axis=-1)], behind.shape[-1]
    with np.errstate(all="ignore"):
        rate = np.nan_to_num(np.clip(np.log(halves[0] / halves[1]) / (side / 2), 0.0, SAMPLES.fastest))
    earlier, later = (np.mean([np.exp(-rate * t) for t in range(count)], axis=0) for count in (wide, side))
    return level + (behind.mean(axis=-1) - level) * np.exp(rate * wide) * earlier / later


def _predicting(t: np.ndarray, degree: int) -> np.ndarray:
    """Weights of samples at ``t`` whose sum is the value at 0 of the polynomial through them."""
    return np.linalg.pinv(np.vander(t, degree + 1, increasing=True))[0]


def standing(recorded: PulseAndRests) -> Index:
    """How many samples of the pulse repeat the one before, where a moving signal would not; else 0.

    Counted where the values four samples on either side differ by more than the recorder's step and the noise
    can account for; two neighbours of independent noise there share a value with a probability of at most
    step / (2 pi^(1/2) sd). Samples at the greatest value are left out: a limit of the recorder repeats it.
    """
    value, sd = recorded.value, recorded.sd
    step = np.where(np.isfinite(recorded.step), recorded.step, 0)
    greatest = recorded.filled(-np.inf).max(axis=1, keepdims=True)
    below = recorded.inside[:, 1:] & (value[:, 1:] < greatest)
    equal = (np.diff(value, axis=1) == 0) & below
    padded = np.pad(value, ((0, 0), (8, 8)), mode="edge")
    change = np.abs(padded[:, 16:] - padded[:, :-16])[:, 1:]
    moving = below & (change > (8 * step + 6 * sd)[:, None])
    chance = np.minimum(step / (2 * np.sqrt(np.pi) * sd), 1.0) * 0.5 + 0.01
    stands = moving & equal
    count, repeated = moving.sum(axis=1), stands.sum(axis=1)
    limit = count * chance + 3.1 * np.sqrt(count * chance) + 2
    thrice = (stands[:, 2:] & stands[:, 1:-1] & stands[:, :-2]).any(axis=1)
    return np.where((repeated > limit) & ((repeated > 0.3 * count) | thrice), repeated, 0)


def levels(recorded: PulseAndRests) -> Column:
    """The recorder's steps in the peak, where there are fewer than 20; NaN elsewhere."""
    count = recorded.peak / recorded.step
    return np.where(count < SAMPLES.levels, count, np.nan)


def segment(recorded: PulseAndRests, quiet: Mask) -> tuple[Rows, Index]:
    """The samples of one rest from the left, 0 past its end, and how many there are."""
    count, first = quiet.sum(axis=1), np.argmax(quiet, axis=1)
    index = np.arange(max(int(count.max(initial=1)), 1))
    column = np.minimum(first[:, None] + index, recorded.value.shape[1] - 1)
    values = np.take_along_axis(recorded.value, column, axis=1)
    return np.where(index < count[:, None], values, 0.0), count


def wave(values: Rows, count: Index) -> tuple[Column, Column]:
    """Root mean square of the slowest five cosines of each row, and the p-value of white noise.

    The cosine transform of white noise is white: the mean square of its five slowest terms, the mean left
    out, over that of all others has the F distribution.
    """
    m, middle = np.maximum(count, 1)[:, None], np.arange(values.shape[1]) + 0.5
    deviation = _centred(values, count)
    total = (deviation**2).sum(axis=1)
    cosines = (np.cos(np.pi * k * middle / m) for k in range(1, SAMPLES.slow + 1))
    slow = sum((deviation * cosine).sum(axis=1) ** 2 * 2 / m[:, 0] for cosine in cosines)
    freedom = np.maximum(count - 1 - SAMPLES.slow, 1)
    ratio = slow / SAMPLES.slow / np.maximum((total - slow) / freedom, 1e-12 * total + 1e-300)
    p = np.where(count >= SAMPLES.fewest, fdtrc(SAMPLES.slow, freedom, ratio), 1.0)
    return np.sqrt(slow / m[:, 0]), p


def _centred(values: Rows, count: Index) -> Rows:
    """Each row less its mean, 0 past its end."""
    mean, _ = segment_moments(values, count)
    return np.where(samples_before(values, count), values - mean[:, None], 0.0)


def slope(values: Rows, count: Index, sd: Column) -> tuple[Column, Column]:
    """Least-squares slope of each row, per sample, and the p-value of none.

    Student's t with the scatter about the line, which is taken no smaller than the recorder's noise ``sd``.
    """
    m, index = np.maximum(count, 3)[:, None], np.arange(values.shape[1])
    time = np.where(index < count[:, None], index - (m - 1) / 2, 0.0)
    square = (m * (m**2 - 1) / 12)[:, 0]
    rate = (values * time).sum(axis=1) / square
    residual = _centred(values, count) - rate[:, None] * time
    freedom = m[:, 0] - 2
    scatter = np.maximum(np.sqrt((residual**2).sum(axis=1) / freedom), sd)
    p = 2 * stdtr(freedom, -np.abs(rate) * np.sqrt(square) / scatter)
    return rate, np.where(count >= SAMPLES.fewest_of_line, p, 1.0)


def uneven(recorded: PulseAndRests, to_peak: Column) -> Mask:
    """A rest before contact that is not level: slower than white noise can be, and large enough to matter.

    A line matters where it goes on until zero velocity, a wave by its own size. After contact a force may
    fade for long, which is no drift.
    """
    values, count = segment(recorded, recorded.before)
    size, p = wave(values, count)
    wavy = (p < SAMPLES.alarms / 2) & (size > SAMPLES.wave * recorded.peak)
    rate, p = slope(values, count, recorded.sd)
    risen = np.abs(rate) * to_peak / recorded.dt
    return wavy | (p < SAMPLES.alarms / 2) & (risen > SAMPLES.shift * recorded.peak)


def level(recorded: PulseAndRests, quiet: Mask) -> Mask:
    """Whether neither a wave nor a line is found in a rest: what fades has not yet come to rest."""
    values, count = segment(recorded, quiet)
    chances = wave(values, count)[1], slope(values, count, recorded.sd)[1]
    return np.minimum(*chances) > SAMPLES.fades


def hum(recorded: PulseAndRests, chosen: Mask) -> Column:
    """The frequency of a sine through both rests, Hz, where it leaves less than a line does; else NaN."""
    frequency, frequencies = np.full(len(recorded.dt), np.nan), np.arange(*SAMPLES.hum_hz)
    for which in np.flatnonzero(chosen):
        index = np.flatnonzero(recorded.before[which] | recorded.after[which])
        time = recorded.time_s[which, index]
        values = recorded.value[which, index]
        line = _sum_of_squares(values, time)
        squares = [_sum_of_squares(values, np.cos(w := 2 * np.pi * f * time), np.sin(w)) for f in frequencies]
        if min(squares) < 0.5 * line and index.size > 2 * SAMPLES.fewest:
            frequency[which] = frequencies[int(np.argmin(squares))]
    return frequency


def _sum_of_squares(values: np.ndarray, *columns: np.ndarray) -> float:
    design = np.column_stack([np.ones_like(values), *columns])
    residual = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return float(residual @ residual)


def mean_at(recorded: PulseAndRests, quiet: Mask) -> tuple[Column, Column]:
    """Mean of one rest and its standard error; NaN where it has fewer than five samples."""
    values, count = segment(recorded, quiet)
    mean, scatter = segment_moments(values, count)
    sd = np.maximum(scatter, recorded.sd)
    return np.where(count >= 5, mean, np.nan), sd / np.sqrt(np.maximum(count, 1))


def moved_zero(recorded: PulseAndRests, gravity: float) -> Column:
    """By how much the mean after contact is off the one before, or off 0 without one, per peak; else 0.

    Force over mass is 0 in flight after contact, and ``gravity`` where the impactor rests on the tissue.
    """
    earlier, its_error = mean_at(recorded, recorded.before)
    later, error = mean_at(recorded, recorded.after)
    known = np.isfinite(earlier)
    change = later - np.where(known, earlier, 0)
    change = np.where(np.abs(change - gravity) < np.abs(change), change - gravity, change)
    error = np.hypot(error, np.where(known, its_error, recorded.sd))
    moved = (np.abs(change) > 5 * error) & (np.abs(change) > SAMPLES.shift * recorded.peak)
    moved &= level(recorded, recorded.after)
    return np.where(moved, change / recorded.peak, 0.0)


def starts_off_zero(recorded: PulseAndRests) -> Column:
    """The first sample as a fraction of the peak, where no rest stands before it and noise is no reason."""
    first = recorded.value[:, 0]
    alone = recorded.before.sum(axis=1) < 5
    off_zero = alone & (np.abs(first) > 5 * recorded.sd) & (np.abs(first) > SAMPLES.first * recorded.peak)
    return np.where(off_zero, first / recorded.peak, 0.0)


def slow_noise(recorded: PulseAndRests, to_peak: Column) -> Column:
    """The frequency that the noise at rest goes up to, Hz, where a low-pass is too slow; else NaN.

    The root mean square of white noise's first differences is 2^(1/2) times its own; of noise that a low-pass
    has slowed it is 2 pi f dt times its own, f its root mean square frequency.
    """
    frequency = np.full(len(recorded.dt), np.nan)
    for quiet in (recorded.before, recorded.after):
        values, count = segment(recorded, quiet)
        m, deviation = np.maximum(count, 2), _centred(values, count)
        steps = np.diff(deviation, axis=1)
        steps = np.where(samples_before(steps, count - 1), steps, 0.0)
        square, change = (deviation**2).sum(axis=1) / (m - 1), (steps**2).sum(axis=1) / (m - 1)
        # Rounding adds a twelfth of a squared step to every sample, and a sixth to every difference.
        change = np.maximum(change - np.where(np.isfinite(recorded.step), recorded.step, 0) ** 2 / 6, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            corner = np.sqrt(change / square) / (2 * np.pi * recorded.dt)
            # Von Neumann's ratio of white noise is 2, with a standard deviation of 2 / m^(1/2).
            slow = (change / square < 2 - 2 * 4 / np.sqrt(m)) & (square > recorded.step**2)
        slow &= (count >= 2 * SAMPLES.fewest) & (corner * to_peak < SAMPLES.passes)
        slow &= level(recorded, quiet) | (quiet is recorded.before)
        frequency = np.where(slow & ~(frequency < corner), corner, frequency)
    return frequency
