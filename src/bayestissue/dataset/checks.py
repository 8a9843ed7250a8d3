"""What can be wrong with recordings, found on all samples of all impacts at once.

Samples and clocks first; then whether a recording can be that of an impact on tissue, by its sign, size,
length and greatest value, as `bayestissue.dataset.motion` has them; and recordings that stand twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64, Shaped

from bayestissue.dataset.motion import Motion, motion
from bayestissue.dataset.plausible import PLAUSIBLE
from bayestissue.dataset.settings import FILE, STANDARD_GRAVITY, LowPassFilter, Quantity, Uncertainty
from bayestissue.dataset.traces import EVEN_WITHIN, LIMITS, MIN_SAMPLES, RATE_WITHIN, Samples, numbers_in
from bayestissue.dataset.twins import twins
from bayestissue.errors import Problem
from bayestissue.outline import counted

_FALLS = "a speed that falls by {:.4g} m/s"


@dataclass(frozen=True, eq=False)
class Recordings:
    """The samples of every impact that has any, and what else the checks need to know.

    Attributes:
        samples: end to end.
        impacts: the rows of ``impacts.csv``, of which each recording has one.
        quantity: what was recorded.
        uncertainty: of the measuring chain.
        gravity: along the motion, m/s².
        recorder: a low-pass that is declared, or None.
    """

    samples: Samples
    impacts: pd.DataFrame
    quantity: Quantity
    uncertainty: Uncertainty
    gravity: float = 0.0
    recorder: LowPassFilter | None = None

    @cached_property
    def name(self) -> Shaped[np.ndarray, " impact"]:
        """Of each impact."""
        return self.impacts["impact"].to_numpy()[self.samples.impact]

    @property
    def velocity(self) -> Float64[np.ndarray, " impact"]:
        """At contact, m/s; nan where it is not known."""
        return numbers_in(self.impacts, "velocity_m_s")[self.samples.impact]

    @property
    def rate(self) -> Float64[np.ndarray, " impact"]:
        """The sampling rate that ``impacts.csv`` states, Hz; nan where it states none."""
        return numbers_in(self.impacts, "sampling_rate_hz")[self.samples.impact]

    def without(self, problems: list[Problem]) -> Recordings:
        """The recordings of impacts that none of the problems concerns."""
        return self._only(~self.impacts["impact"].isin([problem.impact for problem in problems]))

    def of_impacts(self, names: Iterable[str]) -> Recordings:
        """The recordings of these impacts."""
        return self._only(self.impacts["impact"].isin(list(names)))

    def _only(self, keep: pd.Series) -> Recordings:
        mine = keep.to_numpy()[self.samples.impact]
        return self if mine.all() else replace(self, samples=self.samples[mine])

    def problem(
        self,
        key: str,
        which: int | np.integer,
        value: object,
        *,
        at: int | np.integer | None = None,
        column: str | None = None,
        **numbers: Any,
    ) -> Problem:
        """What is wrong with recording ``which``, at the sample ``at`` if it is one sample's fault.

        Args:
            key: of the message: see `Problem.stated`.
            which: recording.
            value: what was found.
            at: which sample.
            column: that of the values unless another is named.
            numbers: in the message.
        """
        file, name = self.samples.file[which], str(self.name[which])
        row = None if at is None else int(self.samples.row[at])
        column = column or self.samples.value_column
        return Problem.stated(key, file, row, column, value, impact=name, **numbers)

    def where(
        self,
        wrong: Bool[np.ndarray, " impact"],
        key: str,
        words: str,
        values: Shaped[np.ndarray, " impact"],
        *,
        column: str | None = None,
        **numbers: Any,
    ) -> Iterator[Problem]:
        """A problem for each recording that is ``wrong``; arguments as of `problem`.

        Args:
            wrong: which recordings are.
            key: of the message.
            words: what is there instead, with braces for the number.
            values: that number of each recording.
            column: that of the values unless another is named.
            numbers: in the message; an array has one of each recording.
        """
        for which in np.flatnonzero(wrong):
            here = {name: n[which] if isinstance(n, np.ndarray) else n for name, n in numbers.items()}
            yield self.problem(key, which, words.format(values[which]), column=column, **here)


@dataclass(frozen=True)
class Findings:
    """What is wrong with recordings, and what only looks odd."""

    problems: list[Problem]
    warnings: list[Problem]


def check_recordings(recordings: Recordings) -> Findings:
    """Check every recording.

    Errors: samples that are no numbers; fewer than 8 of them; time that stands still or runs back, or, of
    displacements and behind a declared low-pass, strays from even spacing by more than a tenth of a step; a
    stated sampling rate more than 1 % off; steps too long
    or recordings too short for an impact, as a wrong unit of time makes them; and what `_movement_problems`
    finds. An impact with an error of one of these kinds is not looked at for the next: it would only raise a
    false alarm.
    """
    problems, recordings = check_samples(recordings)
    if not len(recordings.samples):
        return Findings(problems, [])
    with np.errstate(all="ignore"):
        moving = motion(recordings.samples, recordings.quantity, recordings.gravity)
        problems += _movement_problems(recordings, moving)
        return Findings(problems, [*_same_recordings(recordings), *_movement_warnings(recordings, moving)])


def check_samples(recordings: Recordings) -> tuple[list[Problem], Recordings]:
    """What is wrong with samples and clocks, of whatever was recorded, and the recordings without it."""
    problems: list[Problem] = []
    with np.errstate(all="ignore"):
        for look in (_sample_problems, _clock_problems):
            problems += look(recordings)
            recordings = recordings.without(problems)
            if not len(recordings.samples):
                break
    return problems, recordings


def _sample_problems(recordings: Recordings) -> Iterator[Problem]:
    samples = recordings.samples
    columns = ((samples.time_column, samples.time_s), (samples.value_column, samples.value))
    for column, values in columns:
        bad = np.flatnonzero(~np.isfinite(values))
        owners, first, count = np.unique(samples.owner[bad], return_index=True, return_counts=True)
        for which, at, times in zip(owners, bad[first], count, strict=True):
            cell = samples.text.get(int(at), str(values[at])) or "an empty cell"
            like_it = counted(times - 1, "more sample of this impact is", "more samples of this impact are")
            more = f" {like_it} like this." if times > 1 else ""
            yield recordings.problem("not-a-number.cell", which, cell, at=at, column=column, more=more)
    few = samples.n_samples < MIN_SAMPLES
    yield from recordings.where(
        few, "too-few-samples.recording", "{} samples", samples.n_samples, least=MIN_SAMPLES
    )


def _clock_problems(recordings: Recordings) -> Iterator[Problem]:
    samples, stated, column = recordings.samples, recordings.rate, recordings.samples.time_column
    begin, end, time = samples.begin, samples.end, samples.time_s
    step = np.append(np.diff(time), np.inf)
    # The step from one recording's last sample to the next one's first means nothing.
    step[end - 1] = np.inf
    back = np.flatnonzero(np.minimum.reduceat(step, begin) <= 0)
    for which in back:
        at = begin[which] + np.argmax(step[begin[which] : end[which]] <= 0)
        later = f"{time[at + 1]:.9g} s"
        yield recordings.problem("times-disorder", which, later, at=at + 1, column=column, time=time[at])
    mean, needs_even = samples.interval, _needs_even(recordings)
    for which in np.setdiff1d(np.flatnonzero(samples.uneven), back) if needs_even else ():
        steps = step[begin[which] : end[which] - 1]
        at = int(np.argmax(np.abs(steps - np.median(steps))))
        words = f"a step of {steps[at]:.6g} s where most are {np.median(steps):.6g} s"
        at += begin[which] + 1
        numbers = {"within": EVEN_WITHIN, "reason": needs_even}
        yield recordings.problem("uneven-times.recording", which, words, at=at, column=column, **numbers)
    rate = (samples.n_samples - 1 + samples.lost) / samples.duration
    off = (np.abs(rate / stated - 1) > RATE_WITHIN) & np.isfinite(stated)
    limits = {"stated": stated, "within": RATE_WITHIN}
    yield from recordings.where(off, "sampling-rate.impacts", "{:g} Hz", rate, column=column, **limits)
    limits = {"longest": PLAUSIBLE.longest_step_s, "shortest": PLAUSIBLE.shortest_s}
    lasts, slow = samples.duration, mean > limits["longest"]
    short = (lasts > 0) & (lasts < limits["shortest"])
    yield from recordings.where(slow, "unit.slow-clock", "one every {:.4g} s", mean, column=column, **limits)
    yield from recordings.where(short, "unit.short-clock", "one of {:.4g} s", lasts, column=column, **limits)


def _needs_even(recordings: Recordings) -> str:
    """What asks for even times of these recordings; empty where nothing does."""
    if recordings.recorder is not None:
        return "the declared low-pass of the recorder is applied to evenly spaced samples"
    if recordings.quantity == "displacement":
        return "displacements are read as an evenly sampled ARMA process"
    return ""


def _movement_problems(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    """Recordings that can't be right.

    A channel that never changes; fewer than 8 samples above a tenth of the greatest deceleration; so few that
    do not stand at the sensor's limit, or, of displacements and behind a declared low-pass, four or more at
    it. For decelerations
    also: an impactor that gains speed (the sign is wrong), one that loses more than three times the speed it
    came with (a unit is wrong), and a recording that ends before it has lost that speed, 5 %, one sample and
    three standard deviations of gain, velocity and offset allowed for. Once for all impacts, a declared
    low-pass that is far too slow for the median of them, or a digital one that their samples can't have. For
    displacements: one that goes down where it should go into the tissue, deeper than a metre, or at
    quite another speed than that at contact.
    """
    dead, narrow = moving.high == moving.low, (moving.pulse < MIN_SAMPLES) & (moving.high > moving.low)
    yield from recordings.where(dead, "constant-signal", "{:g} in every sample", moving.high)
    # Of what drifts or is turned around, it is no matter of the sampling rate.
    below = np.abs(recordings.samples.value[moving.peak]) < moving.farthest
    words = "{} samples"
    yield from recordings.where(narrow & ~below, "narrow-peak.few", words, moving.pulse, least=MIN_SAMPLES)
    words = "{:.4g} m/s² at the farthest"
    yield from recordings.where(narrow & below, "narrow-peak.below", words, -moving.farthest)
    yield from _clipped(recordings, moving)
    yield from _impossible_low_pass(recordings, moving)
    yield from (_depths if recordings.quantity == "displacement" else _speeds)(recordings, moving)


def _movement_warnings(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    """Recordings that look odd.

    A displacement that still grows when the recording ends; an impactor that loses more than 2.5 times the
    speed it came with.
    """
    velocity = recordings.velocity
    if recordings.quantity == "displacement":
        sinking = (moving.extreme > 0) & (moving.peak >= recordings.samples.end - 2)
        words = "the greatest displacement at the end"
        yield from recordings.where(sinking, "ends-early.displacement", words, moving.extreme)
        return
    fast = (moving.loss > 2.5 * velocity) & (moving.pulse_loss <= 3 * velocity)
    yield from recordings.where(fast, "velocity-off.much", _FALLS, moving.loss, velocity=velocity)


def _clipped(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    """Clipped recordings that no likelihood takes: see `bayestissue.likelihood.element.clipped`."""
    samples = recordings.samples
    if samples.clipped is None:
        return
    limited = samples.clipped != 0
    slowing = np.abs(samples.value) > PLAUSIBLE.pulse * moving.farthest[samples.owner]
    left = np.add.reduceat((slowing & ~limited).astype(int), samples.begin)
    count = np.add.reduceat(limited.astype(int), samples.begin)
    plateau = count >= LIMITS.plateau
    no_place = recordings.recorder is not None or recordings.quantity == "displacement"
    for which in np.flatnonzero(plateau & no_place | (count > 0) & (left < MIN_SAMPLES)):
        at = samples.begin[which] + int(np.argmax(limited[samples.begin[which] : samples.end[which]]))
        yield recordings.problem(
            "clipped.recording", which, f"{count[which]} samples at {samples.value[at]:g}", at=at
        )


def _impossible_low_pass(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    rise, recorder = moving.rise[moving.rise > 0], recordings.recorder
    if recorder is None or not rise.size:
        return
    corner, typical = recorder.low_pass_hz, float(np.median(rise))
    half_rate = float(((recordings.samples.n_samples - 1) / recordings.samples.duration).min()) / 2
    if recorder.digital and corner >= half_rate:
        column = "recorder.sae_class" if recorder.sae_class else "recorder.low_pass_hz"
        value = f"{corner:g} Hz"
        yield Problem.stated("impossible-low-pass.digital", FILE, None, column, value, half_rate=half_rate)
    elif corner * typical < PLAUSIBLE.slowest:
        yield Problem.stated(
            "impossible-low-pass.slow", FILE, column="recorder.low_pass_hz", value=f"{corner:g} Hz",
            rise_ms=1e3 * typical, typical=1 / typical, least=PLAUSIBLE.slowest / typical,
        )  # fmt: skip


def _depths(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    samples, velocity, depth = recordings.samples, recordings.velocity, moving.extreme
    yield from recordings.where(depth < 0, "sign.displacement", "{:g} m from the first sample", depth)
    deepest = PLAUSIBLE.deepest_m
    yield from recordings.where(depth > deepest, "unit.depth", "{:.4g} m", depth, deepest=deepest)
    speed = np.full(depth.size, np.nan)
    for which in np.flatnonzero((depth > 0) & (depth <= deepest) & (velocity > 0)):
        until_peak = slice(samples.begin[which], moving.peak[which] + 1)
        displaced = samples.value[until_peak] - samples.value[until_peak.start]
        shallow = int(np.flatnonzero(displaced <= PLAUSIBLE.fall_within * displaced[-1])[-1])
        lasts = samples.time_s[moving.peak[which]] - samples.time_s[until_peak][shallow]
        speed[which] = (displaced[-1] - displaced[shallow]) / lasts
    low, high = PLAUSIBLE.mean_speed
    off = ~np.isnan(speed) & ~((low < speed / velocity) & (speed / velocity < high))
    words = "{:.4g} m/s on average"
    yield from recordings.where(off, "velocity-off.displacement", words, speed, velocity=velocity)


def _speeds(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    velocity, uncertainty = recordings.velocity, recordings.uncertainty
    known = np.isfinite(velocity) & (moving.high > moving.low)
    gain_sd, velocity_sd = uncertainty.relative_gain_sd, uncertainty.velocity_sd_m_s / velocity
    allowed = PLAUSIBLE.fall_within + 3 * (gain_sd + velocity_sd)
    # Contact may precede the first sample by an interval, and its jump may be as high as the peak.
    allowed += (moving.step_loss + 3 * uncertainty.offset_sd * moving.duration) / velocity
    faster = known & (moving.gain > 0.5 * velocity) & (moving.gain > moving.loss)
    # How much speed was lost beyond the sensor's limit is not recorded.
    short = known & ~faster & ~recordings.samples.limited
    short &= moving.loss < velocity * (1 - np.minimum(allowed, 0.9))
    absurd = known & ~faster & ~(moving.pulse_loss <= 3 * velocity)
    # A recording that goes on until the force is gone has not ended early.
    last = np.abs(recordings.samples.value[recordings.samples.end - 1])
    gone = last < PLAUSIBLE.gone * moving.farthest
    loss, held = moving.loss, _seconds_at_g(recordings.samples, moving)
    grows, carried = "a speed that grows by {:.4g} m/s", held > PLAUSIBLE.held_s
    for key, which in (("sign.speed", faster & ~carried), ("sign.held", faster & carried)):
        yield from recordings.where(which, key, grows, moving.gain, held=held)
    yield from recordings.where(absurd & carried, "sign.held", _FALLS, moving.pulse_loss, held=held)
    absurd &= ~carried
    # What begins amid the force has lost the speed before: contact, or a trigger, came first.
    first = np.abs(recordings.samples.value[recordings.samples.begin])
    late = short & gone & (first > PLAUSIBLE.amid * moving.farthest)
    yield from recordings.where(late, "starts-above-zero.late", _FALLS, loss, velocity=velocity)
    few = short & gone & ~late
    yield from recordings.where(few, "velocity-off.too-little", _FALLS, loss, velocity=velocity)
    yield from recordings.where(short & ~gone, "ends-early.speed", _FALLS, loss, velocity=velocity)
    yield from recordings.where(absurd, "velocity-off.too-much", _FALLS, moving.pulse_loss, velocity=velocity)


def _seconds_at_g(samples: Samples, moving: Motion) -> Float64[np.ndarray, " impact"]:
    """For how long each recording reads about gravity before its greatest deceleration, s."""
    earlier = np.arange(samples.time_s.size) < moving.peak[samples.owner]
    at_g = np.abs(np.abs(samples.value) / STANDARD_GRAVITY - 1) < PLAUSIBLE.about_g
    return np.add.reduceat((earlier & at_g).astype(np.float64), samples.begin) * samples.interval


def _same_recordings(recordings: Recordings) -> Iterator[Problem]:
    """Recordings of an earlier impact again: see `twins`.

    As two impacts such a recording makes K and C of that person seem known better than they are, and wrong
    where the stated mass or velocity differs.
    """
    for which, earlier, exact in twins(recordings.samples):
        how = (
            "the same samples as" if exact else "with other digits, beginning, gain or rate, the recording of"
        )
        yield recordings.problem("recording-twice", which, f"{how} impact {recordings.name[earlier]}")


def stated_problems(recordings: Recordings) -> Iterator[Problem]:
    """Standard deviations that leave nothing known: of the velocity at contact, and of the recorder's zero.

    Args:
        recordings: with nothing wrong so far.
    """
    sds, velocity = recordings.uncertainty, recordings.velocity[np.isfinite(recordings.velocity)]
    if not len(recordings.samples):
        return
    moving, displaced = motion(recordings.samples, recordings.quantity), recordings.quantity == "displacement"
    reach = np.median(moving.farthest)
    words: dict[str, Any] = {"quantity": recordings.quantity, "unit": "m" if displaced else "m/s^2"}
    for key, name, median in (
        ("velocity", "velocity_sd_m_s", np.median(velocity) if velocity.size else np.inf),
        ("offset", "offset_sd", reach),
    ):
        key, column, sd = f"stated-error-too-large.{key}", f"uncertainty.{name}", getattr(sds, name)
        if sd >= PLAUSIBLE.most_sd * median:
            yield Problem.stated(key, FILE, None, column, sd, median=median, **words)
