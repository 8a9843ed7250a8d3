"""A recording as the detectors see it: where the pulse is, what is at rest, and how large the noise is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayestissue.signal.quality.settings import PULSE
from bayestissue.signal.traces import (
    Column,
    Index,
    Mask,
    Recordings,
    Rows,
    at,
    first_where,
    last_where,
    noise_sd,
)


@dataclass(frozen=True)
class Recorded:
    """Decelerations (or displacements) of all impacts, with what is known before any tissue is assumed.

    Attributes:
        value: [impact, sample], as recorded, its offset included.
        inside: [impact, sample], where there is a sample.
        sample_number: [impact, sample], times since the first sample, in intervals.
        dt: [impact], sampling interval, s.
        peak: [impact], the greatest value above the median of the rest before contact, or above 0.
        top: [impact], where it is.
        sd: [impact], standard deviation of the noise, that of rounding to the recorder's steps included.
        step: [impact], the recorder's step.
        before, after: [impact, sample], the samples surely at rest before contact and after it.
    """

    value: Rows
    inside: Mask
    sample_number: Rows
    dt: Column
    peak: Column
    top: Index
    sd: Column
    step: Column
    before: Mask
    after: Mask

    @property
    def freedom(self) -> Column:
        """Degrees of freedom of ``sd``, about."""
        return np.maximum(PULSE.worth * self.inside.sum(axis=1), 1)

    @property
    def quiet(self) -> Mask:
        """Both rests."""
        return self.before | self.after

    @classmethod
    def from_recordings(cls, recordings: Recordings) -> Recorded:
        """Find pulse and rests by a running median, whatever the noise and whatever stands beside it."""
        value, inside = recordings.value, recordings.inside
        smooth = np.where(inside, _running_median(value, recordings.n), -np.inf)
        top = np.argmax(smooth, axis=1)
        index = np.arange(value.shape[1])
        level = _quiet_level(value, smooth, top)
        peak = at(smooth, top) - level
        low = smooth <= (level + PULSE.low * peak)[:, None]
        rises = last_where(low & (index < top[:, None]))
        falls = first_where(low & (index > top[:, None]), recordings.n)
        foot = rises - np.ceil(PULSE.foot * (top - rises)).astype(int) - 2
        tail = falls + np.ceil(PULSE.tail * (falls - top)).astype(int) + 2
        step = _step(value, inside)
        sd = np.hypot(noise_sd(recordings), np.where(np.isfinite(step), step, 0) / np.sqrt(12))
        return cls(
            value,
            inside,
            recordings.sample_numbers,
            recordings.dt,
            peak,
            top,
            np.maximum(sd, 1e-6 * np.abs(peak) + 1e-300),
            step,
            inside & (index <= foot[:, None]),
            inside & (index >= tail[:, None]),
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


def _running_median(value: Rows, n: Index) -> Rows:
    half = PULSE.median // 2
    index = np.clip(np.arange(value.shape[1]) + np.arange(-half, half + 1)[:, None], 0, None)
    return np.median(
        [np.take_along_axis(value, np.minimum(row, n[:, None] - 1), axis=1) for row in index], axis=0
    )


def _step(value: Rows, inside: Mask) -> Column:
    ordered = np.sort(np.where(inside, value, np.inf), axis=1)
    span = np.where(inside, value, -np.inf).max(axis=1) - ordered[:, 0]
    with np.errstate(invalid="ignore"):
        gaps = np.diff(ordered, axis=1)
        return np.where(gaps > 1e-9 * span[:, None], gaps, np.inf).min(axis=1, initial=np.inf)
