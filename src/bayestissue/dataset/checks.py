"""What can be wrong with recordings: found on all samples of all impacts at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayestissue.dataset.motion import motion
from bayestissue.dataset.plausible import MIN_SAMPLES, clock_problems, movement_problems, movement_warnings
from bayestissue.dataset.recordings import Recordings
from bayestissue.dataset.settings import FILE
from bayestissue.dataset.twice import same_recordings
from bayestissue.errors import Problem

# With half of a quantity as its standard deviation, none of it at all lies within two of them.
_MOST = 0.5


def stated_problems(recordings: Recordings) -> Iterator[Problem]:
    """Standard deviations that leave nothing known: of the velocity at contact, and of the recorder's zero.

    Args:
        recordings: with nothing wrong so far.
    """
    stated = recordings.uncertainty
    if not recordings.name.size:
        return
    velocity = recordings.velocity[np.isfinite(recordings.velocity)]
    if velocity.size and stated.velocity_sd_m_s >= _MOST * np.median(velocity):
        yield Problem(
            FILE,
            f"less than half of the velocity at contact (median {np.median(velocity):.4g} m/s)",
            "Write it in m/s: 5 mm/s is 0.005, and 1 % of 1.5 m/s is 0.015.",
            column="uncertainty.velocity_sd_m_s",
            value=stated.velocity_sd_m_s,
            code="stated-error-too-large",
        )
    moving = motion(recordings.samples, recordings.quantity)
    reach = float(np.median(np.maximum(np.abs(moving.high), np.abs(moving.low))))
    unit = "m" if recordings.quantity == "displacement" else "m/s^2"
    if stated.offset_sd >= _MOST * reach:
        yield Problem(
            FILE,
            f"less than half of the greatest {recordings.quantity} (median {reach:.4g} {unit})",
            f"Write it in {unit}, whatever signal.unit is.",
            column="uncertainty.offset_sd",
            value=stated.offset_sd,
            code="stated-error-too-large",
        )


EVEN_WITHIN = 0.1
RATE_WITHIN = 0.01


@dataclass(frozen=True)
class Findings:
    """What is wrong with recordings, and what only looks odd."""

    problems: list[Problem]
    warnings: list[Problem]


def check_recordings(recordings: Recordings) -> Findings:
    """Check every recording.

    Errors: samples that are no numbers; fewer than 8 of them; time that stands still, runs back, or strays
    from even spacing by more than a tenth of a step; a stated sampling rate more than 1 % off; and what
    `clock_problems` and `movement_problems` find. An impact with an error of one of these kinds is not looked
    at for the next: it would only raise a false alarm.
    """
    problems: list[Problem] = []
    with np.errstate(all="ignore"):
        for look in (_numbers, _times):
            problems += look(recordings)
            recordings = recordings.without(problems)
        if not recordings.name.size:
            return Findings(problems, [])
        moving = motion(recordings.samples, recordings.quantity, recordings.gravity)
        problems += movement_problems(recordings, moving)
        return Findings(problems, [*same_recordings(recordings), *movement_warnings(recordings, moving)])


def _numbers(recordings: Recordings) -> list[Problem]:
    return [*_not_numbers(recordings), *_too_few_samples(recordings)]


def _times(recordings: Recordings) -> list[Problem]:
    if not recordings.name.size:
        return []
    return [*_time(recordings), *_rate(recordings), *clock_problems(recordings)]


def _not_numbers(recordings: Recordings) -> Iterator[Problem]:
    samples = recordings.samples
    columns = ((samples.time_column, samples.time), (samples.value_column, samples.value))
    for column, values in columns:
        bad = np.flatnonzero(~np.isfinite(values))
        if not bad.size:
            continue
        owners, first, count = np.unique(samples.owner[bad], return_index=True, return_counts=True)
        for which, at, times in zip(owners, bad[first], count, strict=True):
            cell = samples.text.get(int(at), str(values[at])) or "an empty cell"
            more = f" {times - 1} more samples of this impact are like this." if times > 1 else ""
            yield recordings.problem(
                which,
                "a finite number",
                f"Correct the cell.{more}",
                value=cell,
                at=at,
                column=column,
                code="not-a-number",
            )


def _too_few_samples(recordings: Recordings) -> Iterator[Problem]:
    samples = recordings.samples
    for which in np.flatnonzero(samples.count < MIN_SAMPLES):
        yield recordings.problem(
            which,
            f"at least {MIN_SAMPLES} samples",
            "Export the whole recording, or take the impact out.",
            value=f"{samples.count[which]} samples",
            code="too-few-samples",
        )


def _time(recordings: Recordings) -> Iterator[Problem]:
    samples = recordings.samples
    begin, end = samples.start[:-1], samples.start[1:]
    step = np.append(np.diff(samples.time), np.inf)
    # The step from one recording's last sample to the next one's first means nothing.
    step[end - 1] = np.inf
    back = np.flatnonzero(np.minimum.reduceat(step, begin) <= 0)
    for which in back:
        at = begin[which] + np.argmax(step[begin[which] : end[which]] <= 0)
        yield recordings.problem(
            which,
            f"a later time than the sample before it ({samples.time[at]:.9g} s)",
            "Put the samples in order and remove repeated ones.",
            value=f"{samples.time[at + 1]:.9g} s",
            at=at + 1,
            column=samples.time_column,
            code="times-disorder",
        )
    mean = (samples.time[end - 1] - samples.time[begin]) / (samples.count - 1)
    owner = samples.owner
    even = samples.time[begin][owner] + mean[owner] * (np.arange(samples.time.size) - begin[owner])
    stray = np.maximum.reduceat(np.abs(samples.time - even), begin)
    for which in np.setdiff1d(np.flatnonzero(~(stray <= EVEN_WITHIN * mean)), back):
        steps = step[begin[which] : end[which] - 1]
        at = int(np.argmax(np.abs(steps - np.median(steps))))
        yield recordings.problem(
            which,
            f"evenly spaced times, each within {EVEN_WITHIN:.0%} of a step",
            "Restore the lost samples or resample the recording evenly.",
            value=f"a step of {steps[at]:.6g} s where most are {np.median(steps):.6g} s",
            at=begin[which] + at + 1,
            column=samples.time_column,
            code="uneven-times",
        )


def _rate(recordings: Recordings) -> Iterator[Problem]:
    samples, stated = recordings.samples, recordings.rate
    begin, end = samples.start[:-1], samples.start[1:]
    rate = (samples.count - 1) / (samples.time[end - 1] - samples.time[begin])
    off = np.abs(rate / stated - 1) > RATE_WITHIN
    for which in np.flatnonzero(off & np.isfinite(stated)):
        yield recordings.problem(
            which,
            f"the sampling rate that impacts.csv states, {stated[which]:g} Hz, within {RATE_WITHIN:.0%}",
            "Correct signal.time_unit, the times, or sampling_rate_hz.",
            value=f"{rate[which]:g} Hz",
            column=samples.time_column,
            code="sampling-rate",
        )
