"""Where contact begins in a recording, and what was recorded before it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayestissue.recordings.dataset.dataset_file import LowPassFilter
from bayestissue.recordings.signal.filters import ahead_s
from bayestissue.recordings.signal.padded_traces import (
    Column,
    Index,
    Mask,
    PaddedTraces,
    at,
    first_where,
    last_where,
    noise_sd,
    samples_before,
    segment_moments,
    standard_error,
)
from bayestissue.recordings.signal.signal_settings import CONTACT, SignalOptions


class QuietPart(NamedTuple):
    """What was recorded before contact while nothing moved, per impact.

    Attributes:
        there: whether there is such a part.
        samples: how many it has.
        offset: their mean, in the unit of the recording, which is subtracted from it; 0 without any. Of a
            recorded displacement its value at contact.
        noise_sd: standard deviation of the recorder's noise, in that unit.
    """

    there: Mask
    samples: Index
    offset: Column
    noise_sd: Column

    @property
    def offset_sd(self) -> Column:
        """Standard deviation of the error of the mean; NaN where there is no quiet part."""
        count = np.maximum(self.samples, 1)
        of_scatter = standard_error(self.noise_sd, count)
        sd = np.where(count >= CONTACT.scatter_samples, of_scatter, self.noise_sd / np.sqrt(count))
        return np.where(self.there, sd, np.nan)

    def zero_sd(self, declared: float | Column) -> Column:
        """[impact], of the zero's error: of this part where there is one, else as declared."""
        return np.where(self.there, self.offset_sd, declared)


@dataclass(frozen=True)
class Onset:
    """What surrounds contact, per impact.

    ``first`` is the first sample certain to be in contact; contact came between ``least`` and ``most``
    seconds before it. ``doubtful`` says that a chosen contact is more than 1 ms, and five samples, from where
    the trace itself shows it. ``reach`` seconds before ``first`` a force that rises from 0 may have begun
    without showing in the noise; 0 where contact is given.
    """

    first: Index
    least: Column
    most: Column
    quiet: QuietPart
    doubtful: Mask
    reach: Column
    blurred: Mask


def find_onset(
    recordings: PaddedTraces, options: SignalOptions, recorder: LowPassFilter | None = None
) -> Onset:
    """See `_onset`; where noise is large beside the peak, in means of so many samples as leave little of it.

    Contact is then known to within the mean's width only. Before it a filter that is run backwards answers.
    """
    sd = noise_sd(recordings)
    ahead = np.ceil(ahead_s(recorder, recordings.dt).max() / recordings.dt).astype(int)
    peak = np.maximum(recordings.filled(0.0).max(axis=1), 0.0)
    share = np.minimum(sd, peak) / np.where(peak > 0, peak, 1.0)
    width = np.minimum((CONTACT.blur * share) ** 2, recordings.n_samples / 8)
    half = np.maximum(np.ceil((width - 1) / 2), 0).astype(int)
    if options.contact != "automatic" or not half.any():
        return _onset(recordings, options, sd, ahead)
    root, blurred = np.sqrt(2 * half + 1), half > 0
    means = _onset(replace(recordings, value=_means(recordings, half)), options, sd / root, ahead)
    margin = 2 * half * recordings.dt
    # Means overlap, and the last of them hold samples in contact: the quiet part is that of the samples.
    last_quiet = means.first - np.rint(means.most / recordings.dt).astype(int)
    of_samples = _quiet_part(recordings, last_quiet - half - ahead, sd, peak)
    pairs = zip(of_samples, means.quiet, strict=True)
    return replace(
        means,
        first=np.minimum(means.first + half, recordings.n_samples - 1),
        most=means.most + margin,
        quiet=QuietPart(*(np.where(blurred, *pair) for pair in pairs)),
        reach=means.reach + margin,
        blurred=blurred,
    )


def _means(recordings: PaddedTraces, half: Index) -> np.ndarray:
    """The mean of each sample and ``half`` of them on either side, of fewer at a recording's ends."""
    sums = np.pad(np.cumsum(recordings.filled(0.0), axis=1), ((0, 0), (1, 0)))
    index = np.arange(recordings.value.shape[1])
    low = np.maximum(index - half[:, None], 0)
    high = np.minimum(index + half[:, None] + 1, recordings.n_samples[:, None])
    rows = np.take_along_axis(sums, high, axis=1) - np.take_along_axis(sums, low, axis=1)
    return np.where(recordings.inside, rows / np.maximum(high - low, 1), recordings.value)


def _onset(recordings: PaddedTraces, options: SignalOptions, noise: Column, ahead: Index) -> Onset:
    """Contact in recorded decelerations (m/s², positive while the impactor slows), all impacts at once.

    automatic: the baseline is the mean of the quiet part, or 0 where the recording has none. Going back
    from the peak, the last sample less than five noise standard deviations above the baseline ends the
    search: the one after it is certain to be in contact, and contact lies after the last sample within three
    standard deviations. Where the rise is so gentle that several samples lie between the two, half as many
    again are allowed for before. What a filter run backwards answers, ``ahead`` samples before contact, is
    not quiet. threshold and time-zero: see `SignalOptions`.
    """
    deceleration = recordings.filled(-np.inf)
    peak_index = np.argmax(deceleration, axis=1)
    peak = at(recordings.value, peak_index)
    until_peak = samples_before(deceleration, peak_index + 1)

    def last_below(level: Column) -> Index:
        return last_where((deceleration <= level[:, None]) & until_peak)

    sd = np.maximum(noise, CONTACT.rounding * np.abs(peak))
    baseline = _first_baseline(recordings, peak, last_below)
    first = last_below(baseline + CONTACT.certain * sd) + 1
    _, _, baseline, sd = _quiet_part(recordings, first - ahead, sd, peak)
    # The second look has the mean and the scatter of the whole quiet part to go by.
    first = last_below(baseline + CONTACT.certain * sd) + 1
    last_quiet = _last_quiet(recordings, first, baseline, sd)
    quiet = _quiet_part(recordings, last_quiet - ahead, sd, peak)
    sd = quiet.noise_sd
    least, most = np.zeros(len(peak)), recordings.span(last_quiet, first)
    shown, earliest = first, most
    passed = (deceleration >= (baseline + 2 * CONTACT.certain * sd)[:, None]) & until_peak
    passed &= ~samples_before(deceleration, first)
    rise = recordings.span(first, first_where(passed, first))
    reach = np.maximum(CONTACT.reach * most, CONTACT.rises * rise) + 2 * recordings.dt
    if options.contact == "threshold":
        level = quiet.offset + CONTACT.threshold * (peak - quiet.offset)
        first = last_below(level) + 1
        most = least = _since_crossing(recordings, level, first) * recordings.span(first - 1, first)
        reach = reach + np.maximum(recordings.span(shown, first), 0)
    elif options.contact == "time-zero":
        first, least = from_time_zero(recordings)
        quiet = _quiet_part(recordings, first - 1 - ahead, sd, peak)
        most, reach = least, np.zeros_like(least)
    later = recordings.span(shown, first) - least
    tolerance = np.maximum(CONTACT.doubtful_s, 5 * recordings.dt)
    doubtful = (least == most) & ((later > tolerance) | (later < -earliest - tolerance))
    return Onset(first, least, most, quiet, doubtful, reach, np.zeros_like(doubtful))


def displacement_contact(recordings: PaddedTraces, options: SignalOptions) -> tuple[Index, Column]:
    """The first sample of a displacement at or after contact, and the seconds from contact to it.

    automatic: displacement is counted into the tissue, so contact is where it last passes 0 on its way up
    to the peak, or the first sample where the recording begins above 0. threshold: where it passes that
    fraction of its peak. time-zero: time 0.
    """
    if options.contact == "time-zero":
        return from_time_zero(recordings)
    x = recordings.filled(-np.inf)
    top = np.argmax(x, axis=1)
    level = CONTACT.threshold * x.max(axis=1) if options.contact == "threshold" else np.zeros(len(x))
    until_peak = samples_before(x, top + 1)
    # A rest of exact zeros, as a coarse recorder writes it, is before contact; its last zero may be contact.
    still = np.pad((x[:, :-1] == level[:, None]) & (x[:, 1:] == level[:, None]), ((0, 0), (0, 1)))
    first = last_where(((x < level[:, None]) | still) & until_peak) + 1
    return first, _since_crossing(recordings, level, first) * recordings.dt


def from_time_zero(recordings: PaddedTraces) -> tuple[Index, Column]:
    """The first sample at or after time 0, and the seconds from time 0 to it."""
    # Times are sums and quotients in floating point: a millionth of an interval counts as no time.
    since = -recordings.start / recordings.dt - 1e-6
    behind = recordings.inside & (recordings.sample_numbers >= since[:, None])
    first = first_where(behind, recordings.n_samples - 1)
    return first, np.maximum(recordings.start + recordings.sample_number_of(first) * recordings.dt, 0)


def _first_baseline(recordings: PaddedTraces, peak: Column, last_below: Callable[[Column], Index]) -> Column:
    start, _ = segment_moments(recordings.value, np.minimum(recordings.n_samples, CONTACT.quiet_samples))
    start = np.where(start < CONTACT.quiet_ceiling * peak, start, 0)
    low = last_below(start + 0.2 * (peak - start)) + 1
    # The later half of these samples may hold the foot of a gentle rise.
    mean, _ = segment_moments(recordings.value, low // 2)
    return np.where((low // 2 >= CONTACT.quiet_samples) & (mean < CONTACT.quiet_ceiling * peak), mean, start)


def _quiet_part(recordings: PaddedTraces, end: Index, sd: Column, peak: Column) -> QuietPart:
    end = np.maximum(end, 0)
    mean, scatter = segment_moments(recordings.value, end)
    early, _ = segment_moments(recordings.value, end // 2)
    drift = 2 * np.abs(mean - early)
    level = drift <= np.maximum(CONTACT.quiet_drift * peak, 8 * sd / np.sqrt(np.maximum(end, 1)))
    quiet = (end >= CONTACT.quiet_samples) & level & (np.abs(mean) < CONTACT.quiet_ceiling * peak)
    # Without a quiet part the baseline is 0: an offset can't be told from the impact itself.
    measured = quiet & (end >= CONTACT.scatter_samples)
    noise = np.where(measured, np.maximum(scatter, CONTACT.rounding * peak), sd)
    return QuietPart(quiet, np.where(quiet, end, 0), np.where(quiet, mean, 0), noise)


def _last_quiet(recordings: PaddedTraces, first: Index, baseline: Column, sd: Column) -> Index:
    before = samples_before(recordings.value, first)
    last = last_where((recordings.value <= (baseline + CONTACT.quiet * sd)[:, None]) & before)
    gap = first - last
    # Where d jumps there is no foot: the sample before the jump is a quiet one that noise has lifted.
    jump = at(recordings.value, first) - at(recordings.value, first - 1) > 2 * CONTACT.certain * sd
    last = np.where(jump & (gap > 1), first - 1, last)
    gap = first - last
    return np.maximum(last - np.where(gap > 1, np.ceil(1.5 * gap).astype(int), 0), -1)


def _since_crossing(recordings: PaddedTraces, level: Column, first: Index) -> Column:
    """The part of the interval before sample ``first`` in which the straight line was above ``level``."""
    above, below = at(recordings.value, first), at(recordings.value, first - 1)
    rise = np.where(above > below, above - below, 1)
    return np.where(first > 0, (above - level) / rise, 0)
