"""What can be wrong with recordings: found on all samples of all impacts at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayestissue.dataset.model import Quantity, Uncertainty
from bayestissue.dataset.motion import Motion, flat_top, motion
from bayestissue.dataset.samples import Samples
from bayestissue.errors import Problem

MIN_SAMPLES = 8
EVEN_WITHIN = 0.1
RATE_WITHIN = 0.01
FLAT_SAMPLES = 3
FALL_WITHIN = 0.05


@dataclass(frozen=True)
class Findings:
    """What is wrong with recordings, and what only looks odd."""

    problems: list[Problem]
    warnings: list[Problem]


def check_samples(
    samples: Samples, impacts: pd.DataFrame, quantity: Quantity, uncertainty: Uncertainty
) -> Findings:
    """Check every recording.

    Errors: samples that are no numbers; fewer than 8 of them, in all or in contact; time that stands
    still, runs back, or strays from even spacing by more than a tenth of a step; a stated sampling rate
    more than 1 % off; a channel that never changes; three or more samples on end at one extreme value with
    a jump beside them (a recorder's limit). For decelerations also: an impactor that gains speed (the sign
    is wrong), one that loses more than four times the speed it came with (a unit is wrong), and a recording
    that ends before it has lost that speed, 5 % and three standard deviations of gain and velocity allowed
    for. For displacements: one that goes down where it should go into the tissue. A displacement that still
    grows when the recording ends is a warning.

    Args:
        samples: of all impacts that have any.
        impacts: the checked table.
        quantity: what was recorded.
        uncertainty: of the measuring chain.
    """
    problems: list[Problem] = []
    warnings: list[Problem] = []
    with np.errstate(all="ignore"):
        for look in (_numbers, _times, _movement):
            if not samples.impact.size:
                break
            # What is broken in one respect would only raise a false alarm in the next.
            report = _Reporter(samples, impacts["impact"].to_numpy()[samples.impact])
            found = look(samples, impacts, quantity, uncertainty, report)
            problems += found.problems
            warnings += found.warnings
            broken = {problem.impact for problem in found.problems}
            samples = samples.only(np.array([name not in broken for name in report.names], dtype=bool))
    return Findings(problems, warnings)


@dataclass(frozen=True)
class _Reporter:
    samples: Samples
    names: np.ndarray

    def __call__(
        self,
        which: int | np.integer,
        expected: str,
        remedy: str,
        *,
        value: object,
        at: int | np.integer | None = None,
        column: str | None = None,
    ) -> Problem:
        return Problem(
            self.samples.file[which],
            expected,
            remedy,
            row=None if at is None else int(self.samples.row[at]),
            column=column or self.samples.value_column,
            value=value,
            impact=str(self.names[which]) or None,
        )


def _numbers(
    samples: Samples, impacts: pd.DataFrame, quantity: Quantity, uncertainty: Uncertainty, report: _Reporter
) -> Findings:
    return Findings([*_not_numbers(samples, report), *_few(samples, report)], [])


def _times(
    samples: Samples, impacts: pd.DataFrame, quantity: Quantity, uncertainty: Uncertainty, report: _Reporter
) -> Findings:
    return Findings([*_time(samples, report), *_rate(samples, impacts, report)], [])


def _movement(
    samples: Samples, impacts: pd.DataFrame, quantity: Quantity, uncertainty: Uncertainty, report: _Reporter
) -> Findings:
    moving = motion(samples, quantity)
    velocity = impacts["velocity_m_s"].to_numpy()[samples.impact]
    problems = [*_dead(moving, report), *_coarse(moving, report)]
    problems += _clipped(samples, moving, quantity, report)
    if quantity == "displacement":
        problems += _wrong_way(moving, report)
        return Findings(problems, list(_still_sinking(samples, moving, report)))
    problems += _speeds(moving, velocity, uncertainty, report)
    return Findings(problems, list(_fast(moving, velocity, report)))


def _not_numbers(samples: Samples, report: _Reporter) -> Iterator[Problem]:
    columns = ((samples.time_column, samples.time), (samples.value_column, samples.value))
    for column, values in columns:
        bad = np.flatnonzero(~np.isfinite(values))
        if not bad.size:
            continue
        owners, first, count = np.unique(samples.owner[bad], return_index=True, return_counts=True)
        for which, at, times in zip(owners, bad[first], count, strict=True):
            found = samples.text.get(int(at), str(values[at])) or "an empty cell"
            more = f" {times - 1} more samples of this impact are like this." if times > 1 else ""
            yield report(
                which, "a finite number", f"Correct the cell.{more}", value=found, at=at, column=column
            )


def _few(samples: Samples, report: _Reporter) -> Iterator[Problem]:
    for which in np.flatnonzero(samples.count < MIN_SAMPLES):
        yield report(
            which,
            f"at least {MIN_SAMPLES} samples",
            "Export the whole recording, or take the impact out.",
            value=f"{samples.count[which]} samples",
        )


def _time(samples: Samples, report: _Reporter) -> Iterator[Problem]:
    begin, end = samples.start[:-1], samples.start[1:]
    step = np.append(np.diff(samples.time), np.inf)
    # The step from one recording's last sample to the next one's first means nothing.
    step[end - 1] = np.inf
    back = np.flatnonzero(np.minimum.reduceat(step, begin) <= 0)
    for which in back:
        at = begin[which] + np.argmax(step[begin[which] : end[which]] <= 0)
        yield report(
            which,
            f"a later time than the sample before it ({samples.time[at]:.9g} s)",
            "Put the samples in order and remove repeated ones.",
            value=f"{samples.time[at + 1]:.9g} s",
            at=at + 1,
            column=samples.time_column,
        )
    mean = (samples.time[end - 1] - samples.time[begin]) / (samples.count - 1)
    owner = samples.owner
    even = samples.time[begin][owner] + mean[owner] * (np.arange(samples.time.size) - begin[owner])
    stray = np.maximum.reduceat(np.abs(samples.time - even), begin)
    for which in np.setdiff1d(np.flatnonzero(~(stray <= EVEN_WITHIN * mean)), back):
        steps = step[begin[which] : end[which] - 1]
        at = int(np.argmax(np.abs(steps - np.median(steps))))
        yield report(
            which,
            f"evenly spaced times, each within {EVEN_WITHIN:.0%} of a step",
            "Restore the lost samples or resample the recording evenly.",
            value=f"a step of {steps[at]:.6g} s where most are {np.median(steps):.6g} s",
            at=begin[which] + at + 1,
            column=samples.time_column,
        )


def _rate(samples: Samples, impacts: pd.DataFrame, report: _Reporter) -> Iterator[Problem]:
    if "sampling_rate_hz" not in impacts:
        return
    stated = impacts["sampling_rate_hz"].to_numpy()[samples.impact]
    begin, end = samples.start[:-1], samples.start[1:]
    found = (samples.count - 1) / (samples.time[end - 1] - samples.time[begin])
    off = np.abs(found / stated - 1) > RATE_WITHIN
    for which in np.flatnonzero(off & np.isfinite(stated)):
        yield report(
            which,
            f"the sampling rate that impacts.csv states, {stated[which]:g} Hz, within {RATE_WITHIN:.0%}",
            "Correct signal.time_unit, the times, or sampling_rate_hz.",
            value=f"{found[which]:g} Hz",
            column=samples.time_column,
        )


def _dead(moving: Motion, report: _Reporter) -> Iterator[Problem]:
    for which in np.flatnonzero(moving.high == moving.low):
        yield report(
            which,
            "a signal that changes",
            "Check which channel was exported.",
            value=f"{moving.high[which]:g} in every sample",
        )


def _coarse(moving: Motion, report: _Reporter) -> Iterator[Problem]:
    for which in np.flatnonzero((moving.pulse < MIN_SAMPLES) & (moving.high > moving.low)):
        yield report(
            which,
            f"at least {MIN_SAMPLES} samples above a tenth of the greatest deceleration",
            "Record at a higher rate, or check that this is an impact.",
            value=f"{moving.pulse[which]} samples",
        )


def _clipped(samples: Samples, moving: Motion, quantity: Quantity, report: _Reporter) -> Iterator[Problem]:
    for which, at, length, top in flat_top(samples, moving, quantity, FLAT_SAMPLES):
        yield report(
            which,
            "a peak below the recorder's limit",
            "Record again with a wider range, or take the impact out: what lies above the limit is lost.",
            value=f"{length} samples on end at {top:g}",
            at=at,
        )


def _wrong_way(moving: Motion, report: _Reporter) -> Iterator[Problem]:
    for which in np.flatnonzero(moving.first_way < 0):
        yield report(
            which,
            "a displacement that grows as the impactor goes into the tissue",
            "Write a negative signal.scale in dataset.toml if the recorder counts the other way.",
            value=f"{moving.extreme[which]:g} m from the first sample",
        )


def _still_sinking(samples: Samples, moving: Motion, report: _Reporter) -> Iterator[Problem]:
    for which in np.flatnonzero((moving.first_way > 0) & (moving.peak >= samples.start[1:] - 2)):
        yield report(
            which,
            "a recording that goes on past the greatest displacement",
            "Zero velocity may lie beyond the end of the recording.",
            value="the greatest displacement at the end",
        )


def _speeds(
    moving: Motion, velocity: np.ndarray, uncertainty: Uncertainty, report: _Reporter
) -> Iterator[Problem]:
    known = np.isfinite(velocity) & (moving.high > moving.low)
    allowed = FALL_WITHIN + 3 * (uncertainty.relative_gain_sd + uncertainty.velocity_sd_m_s / velocity)
    faster = known & (moving.gain > 0.5 * velocity) & (moving.gain > moving.loss)
    short = known & ~faster & (moving.loss < velocity * (1 - np.minimum(allowed, 0.9)))
    absurd = known & ~faster & ~(moving.pulse_loss <= 4 * velocity)
    for which in np.flatnonzero(faster):
        yield report(
            which,
            "an impactor that slows down",
            'Is signal.quantity right? An "acceleration" is the negative of a "deceleration".',
            value=f"a speed that grows by {moving.gain[which]:.4g} m/s",
        )
    for which in np.flatnonzero(short):
        yield report(
            which,
            f"a recording until zero velocity: the speed must fall by {velocity[which]:.4g} m/s",
            "Export a longer recording; check signal.unit, signal.scale and the velocity too.",
            value=f"a speed that falls by {moving.loss[which]:.4g} m/s",
        )
    for which in np.flatnonzero(absurd):
        yield report(
            which,
            f"a speed that falls by no more than twice the {velocity[which]:.4g} m/s at contact",
            "Check signal.unit, signal.scale and the velocity in impacts.csv.",
            value=f"a speed that falls by {moving.pulse_loss[which]:.4g} m/s",
        )


def _fast(moving: Motion, velocity: np.ndarray, report: _Reporter) -> Iterator[Problem]:
    odd = (moving.loss > 2.5 * velocity) & (moving.pulse_loss <= 4 * velocity)
    for which in np.flatnonzero(odd):
        yield report(
            which,
            f"a speed that falls by no more than twice the {velocity[which]:.4g} m/s at contact",
            "Has the recorder an offset? Check signal.offset, signal.unit and the velocity.",
            value=f"a speed that falls by {moving.loss[which]:.4g} m/s",
        )
