"""What can be wrong with recordings, found on all samples of all impacts at once.

Samples and clocks first; then whether a recording can be that of an impact on tissue, by its sign, size,
length and greatest value, as `bayestissue.recordings.dataset.recordings.Motion` has them; and recordings
that stand twice.

A further check is a function of `Recordings`, in a module of its own where it compares recordings as
`bayestissue.recordings.dataset.twins` does, a line among the stages below, and its words in
``remedies.toml``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import Problem
from bayestissue.base.outline import counted
from bayestissue.recordings.dataset.dataset_file import FILE, STANDARD_GRAVITY
from bayestissue.recordings.dataset.plausible import PLAUSIBLE
from bayestissue.recordings.dataset.ragged_traces import (
    EVEN_WITHIN,
    LIMITS,
    MIN_SAMPLES,
    RATE_WITHIN,
    PerImpact,
    PerSample,
)
from bayestissue.recordings.dataset.recordings import Recordings, numbers_in
from bayestissue.recordings.dataset.twins import recording_twice

_FALLS = "a speed that falls by {:.4g} m/s"


def _sample_problems(recordings: Recordings) -> Iterator[Problem]:
    signal = recordings.signal
    for column, values in ((signal.time_column, recordings.time_s), (signal.value_column, recordings.value)):
        bad = np.flatnonzero(~np.isfinite(values))
        owners, first, count = np.unique(recordings.owner[bad], return_index=True, return_counts=True)
        for which, at, times in zip(owners, bad[first], count, strict=True):
            cell = recordings.text.get(int(at), str(values[at])) or "an empty cell"
            like_it = counted(times - 1, "more sample of this impact is", "more samples of this impact are")
            more = f" {like_it} like this." if times > 1 else ""
            yield recordings.problem("not-a-number.cell", which, cell, at=at, column=column, more=more)
    few = recordings.n_samples < MIN_SAMPLES
    yield from recordings.where(
        few, "too-few-samples.recording", "{} samples", recordings.n_samples, least=MIN_SAMPLES
    )


def _clock_problems(recordings: Recordings) -> Iterator[Problem]:
    begin, end, time = recordings.begin, recordings.end, recordings.time_s
    stated = numbers_in(recordings.impacts, "sampling_rate_hz")[recordings.position]
    column = recordings.signal.time_column
    step = np.append(np.diff(time), np.inf)
    # The step from one recording's last sample to the next one's first means nothing.
    step[end - 1] = np.inf
    back = np.flatnonzero(recordings.least(step) <= 0)
    for which in back:
        at = begin[which] + np.argmax(step[begin[which] : end[which]] <= 0)
        later = f"{time[at + 1]:.9g} s"
        yield recordings.problem("times-disorder", which, later, at=at + 1, column=column, time=time[at])
    mean, needs_even = recordings.interval, _needs_even(recordings)
    for which in np.setdiff1d(np.flatnonzero(recordings.uneven), back) if needs_even else ():
        steps = step[begin[which] : end[which] - 1]
        at = int(np.argmax(np.abs(steps - np.median(steps))))
        words = f"a step of {steps[at]:.6g} s where most are {np.median(steps):.6g} s"
        at += begin[which] + 1
        numbers = {"within": EVEN_WITHIN, "reason": needs_even}
        yield recordings.problem("uneven-times.recording", which, words, at=at, column=column, **numbers)
    rate = (recordings.n_samples - 1 + recordings.lost) / recordings.duration
    off = (np.abs(rate / stated - 1) > RATE_WITHIN) & np.isfinite(stated)
    limits = {"stated": stated, "within": RATE_WITHIN}
    yield from recordings.where(off, "sampling-rate.impacts", "{:g} Hz", rate, column=column, **limits)
    limits = {"longest": PLAUSIBLE.longest_step_s, "shortest": PLAUSIBLE.shortest_s}
    lasts, slow = recordings.duration, mean > limits["longest"]
    short = (lasts > 0) & (lasts < limits["shortest"])
    yield from recordings.where(slow, "unit.slow-clock", "one every {:.4g} s", mean, column=column, **limits)
    yield from recordings.where(short, "unit.short-clock", "one of {:.4g} s", lasts, column=column, **limits)


def _needs_even(recordings: Recordings) -> str:
    """What asks for even times of these recordings; empty where nothing does."""
    quantity = recordings.settings.signal.quantity
    # The low-pass that is declared is the first channel's.
    if recordings.settings.recorder is not None and recordings.signal.quantity == quantity:
        return "the declared low-pass of the recorder is applied to evenly spaced samples"
    if quantity == "displacement":
        return "displacements are read as an evenly sampled ARMA process"
    return ""


def _movement_problems(recordings: Recordings) -> Iterator[Problem]:
    """Movements that can't be right.

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
    moving = recordings.moving
    dead, narrow = moving.high == moving.low, (moving.pulse < MIN_SAMPLES) & (moving.high > moving.low)
    yield from recordings.where(dead, "constant-signal", "{:g} in every sample", moving.high)
    # Of what drifts or is turned around, it is no matter of the sampling rate.
    below = np.abs(recordings.value[moving.peak]) < moving.farthest
    words = "{} samples"
    yield from recordings.where(narrow & ~below, "narrow-peak.few", words, moving.pulse, least=MIN_SAMPLES)
    words = "{:.4g} m/s² at the farthest"
    yield from recordings.where(narrow & below, "narrow-peak.below", words, -moving.farthest)
    yield from _clipped(recordings)
    yield from _impossible_low_pass(recordings)
    yield from (_depths if recordings.settings.signal.quantity == "displacement" else _speeds)(recordings)


def _movement_warnings(recordings: Recordings) -> Iterator[Problem]:
    """Movements that look odd.

    A displacement that still grows when the recording ends; an impactor that loses more than 2.5 times the
    speed it came with.
    """
    velocity, moving = recordings.velocity, recordings.moving
    if recordings.settings.signal.quantity == "displacement":
        sinking = (moving.extreme > 0) & (moving.peak >= recordings.end - 2)
        words = "the greatest displacement at the end"
        yield from recordings.where(sinking, "ends-early.displacement", words, moving.extreme)
        return
    fast = (moving.loss > 2.5 * velocity) & (moving.pulse_loss <= 3 * velocity)
    yield from recordings.where(fast, "velocity-off.much", _FALLS, moving.loss, velocity=velocity)


def _clipped(recordings: Recordings) -> Iterator[Problem]:
    """Clipped recordings that no likelihood takes: see `bayestissue.model.likelihood.impact`."""
    moving, quantity = recordings.moving, recordings.settings.signal.quantity
    limited, begin = recordings.clipped != 0, recordings.begin
    slowing = np.abs(recordings.value) > PLAUSIBLE.pulse * moving.farthest[recordings.owner]
    left, count = map(recordings.total, (slowing & ~limited, limited))
    plateau = count >= LIMITS.plateau
    no_place = recordings.settings.recorder is not None or quantity == "displacement"
    for which in np.flatnonzero(plateau & no_place | (count > 0) & (left < MIN_SAMPLES)):
        at = begin[which] + int(np.argmax(limited[begin[which] : recordings.end[which]]))
        value = f"{count[which]} samples at {recordings.value[at]:g}"
        yield recordings.problem("clipped.recording", which, value, at=at)


def _impossible_low_pass(recordings: Recordings) -> Iterator[Problem]:
    moving, recorder = recordings.moving, recordings.settings.recorder
    rise = moving.rise[moving.rise > 0]
    if recorder is None or not rise.size:
        return
    corner, typical = recorder.low_pass_hz, float(np.median(rise))
    half_rate = float(((recordings.n_samples - 1) / recordings.duration).min()) / 2
    if recorder.digital and corner >= half_rate:
        column = "recorder.sae_class" if recorder.sae_class else "recorder.low_pass_hz"
        value = f"{corner:g} Hz"
        yield Problem.stated("impossible-low-pass.digital", FILE, None, column, value, half_rate=half_rate)
    elif corner * typical < PLAUSIBLE.slowest:
        yield Problem.stated(
            "impossible-low-pass.slow", FILE, column="recorder.low_pass_hz", value=f"{corner:g} Hz",
            rise_ms=1e3 * typical, typical=1 / typical, least=PLAUSIBLE.slowest / typical,
        )  # fmt: skip


def _depths(recordings: Recordings) -> Iterator[Problem]:
    velocity, moving = recordings.velocity, recordings.moving
    depth = moving.extreme
    yield from recordings.where(depth < 0, "sign.displacement", "{:g} m from the first sample", depth)
    deepest = PLAUSIBLE.deepest_m
    yield from recordings.where(depth > deepest, "unit.depth", "{:.4g} m", depth, deepest=deepest)
    speed = np.full(depth.size, np.nan)
    for which in np.flatnonzero((depth > 0) & (depth <= deepest) & (velocity > 0)):
        until_peak = slice(recordings.begin[which], moving.peak[which] + 1)
        displaced = recordings.value[until_peak] - recordings.value[until_peak.start]
        shallow = int(np.flatnonzero(displaced <= PLAUSIBLE.fall_within * displaced[-1])[-1])
        lasts = recordings.time_s[moving.peak[which]] - recordings.time_s[until_peak][shallow]
        speed[which] = (displaced[-1] - displaced[shallow]) / lasts
    low, high = PLAUSIBLE.mean_speed
    off = ~np.isnan(speed) & ~((low < speed / velocity) & (speed / velocity < high))
    words = "{:.4g} m/s on average"
    yield from recordings.where(off, "velocity-off.displacement", words, speed, velocity=velocity)


def _speeds(recordings: Recordings) -> Iterator[Problem]:
    velocity, uncertainty, moving = recordings.velocity, recordings.settings.uncertainty, recordings.moving
    known = np.isfinite(velocity) & (moving.high > moving.low)
    gain_sd, velocity_sd = uncertainty.relative_gain_sd, uncertainty.velocity_sd_m_s / velocity
    allowed = PLAUSIBLE.fall_within + 3 * (gain_sd + velocity_sd)
    # Contact may precede the first sample by an interval, and its jump may be as high as the peak.
    allowed += (moving.step_loss + 3 * uncertainty.offset_sd * moving.pulse * recordings.interval) / velocity
    faster = known & (moving.gain > 0.5 * velocity) & (moving.gain > moving.loss)
    # How much speed was lost beyond the sensor's limit is not recorded.
    short = known & ~faster & ~recordings.limited
    short &= moving.loss < velocity * (1 - np.minimum(allowed, 0.9))
    absurd = known & ~faster & ~(moving.pulse_loss <= 3 * velocity)
    # A recording that goes on until the force is gone has not ended early.
    last = np.abs(recordings.value[recordings.end - 1])
    gone = last < PLAUSIBLE.gone * moving.farthest
    loss, held = moving.loss, _seconds_at_g(recordings)
    grows, carried = "a speed that grows by {:.4g} m/s", held > PLAUSIBLE.held_s
    for key, which in (("sign.speed", faster & ~carried), ("sign.held", faster & carried)):
        yield from recordings.where(which, key, grows, moving.gain, held=held)
    yield from recordings.where(absurd & carried, "sign.held", _FALLS, moving.pulse_loss, held=held)
    absurd &= ~carried
    # What begins amid the force has lost the speed before: contact, or a trigger, came first.
    first = np.abs(recordings.value[recordings.begin])
    late = short & gone & (first > PLAUSIBLE.amid * moving.farthest)
    yield from recordings.where(late, "starts-above-zero.late", _FALLS, loss, velocity=velocity)
    few = short & gone & ~late
    yield from recordings.where(few, "velocity-off.too-little", _FALLS, loss, velocity=velocity)
    yield from recordings.where(short & ~gone, "ends-early.speed", _FALLS, loss, velocity=velocity)
    yield from recordings.where(absurd, "velocity-off.too-much", _FALLS, moving.pulse_loss, velocity=velocity)


def _seconds_at_g(recordings: Recordings) -> PerImpact:
    """For how long each recording reads about gravity before its greatest deceleration, s."""
    earlier = np.arange(recordings.time_s.size) < recordings.moving.peak[recordings.owner]
    at_g = np.abs(np.abs(recordings.value) / STANDARD_GRAVITY - 1) < PLAUSIBLE.about_g
    return recordings.total(earlier & at_g) * recordings.interval


def stated_problems(recordings: Recordings) -> Iterator[Problem]:
    """Standard deviations that leave nothing known: of the velocity at contact, and of the recorder's zero.

    Args:
        recordings: with nothing wrong so far.
    """
    sds, quantity = recordings.settings.uncertainty, recordings.settings.signal.quantity
    velocity = recordings.velocity[np.isfinite(recordings.velocity)]
    if not len(recordings):
        return
    displaced, reach = quantity == "displacement", np.median(recordings.moving.farthest)
    words: dict[str, Any] = {"quantity": quantity, "unit": "m" if displaced else "m/s^2"}
    for key, name, median in (
        ("velocity", "velocity_sd_m_s", np.median(velocity) if velocity.size else np.inf),
        ("offset", "offset_sd", reach),
    ):
        key, column, sd = f"stated-error-too-large.{key}", f"uncertainty.{name}", getattr(sds, name)
        if sd >= PLAUSIBLE.most_sd * median:
            yield Problem.stated(key, FILE, None, column, sd, median=median, **words)


def against_first(recordings: Recordings, first: Recordings) -> Iterator[Problem]:
    """What the first channel says against a further one's recordings, whose samples and clocks are sound.

    Times that do not meet the first channel's, a channel that never changes, and a force of the wrong sign.
    """
    recordings = recordings.of_impacts(first.name)
    if not len(recordings):
        return
    owner, reference = recordings.owner, first.slowing(first.signal.quantity)
    mine = pd.Index(first.name).get_indexer(pd.Index(recordings.name))[owner]
    inside = (recordings.time_s >= reference.time_s[reference.begin][mine]) & (
        recordings.time_s <= reference.time_s[reference.end - 1][mine]
    )
    recorded = reference.interpolated(recordings.time_s, mine)
    count = recordings.total(inside)
    apart = count < MIN_SAMPLES
    words = "{} of its samples while the first channel was recorded"
    yield from recordings.where(apart, "channel-unfit.apart", words, count, least=MIN_SAMPLES)

    def centred(values: PerSample) -> PerSample:
        values = np.where(inside, values, 0.0)
        mean = recordings.total(values) / np.maximum(count, 1)
        return np.where(inside, values - mean[owner], 0.0)

    force, compared = centred(recordings.value), centred(recorded)
    dead = ~apart & (recordings.greatest(np.abs(force)) == 0)
    yield from recordings.where(
        dead, "constant-signal", "{:g} in every sample", recordings.value[recordings.begin]
    )
    together = recordings.total(force * compared)
    sizes = [np.sqrt(recordings.total(one**2)) for one in (force, compared)]
    correlation = together / np.maximum(sizes[0] * sizes[1], np.finfo(float).tiny)
    wrong = ~apart & ~dead & (correlation < 0)
    yield from recordings.where(wrong, "channel-unfit.sign", "a correlation of {:.2f}", correlation)


type Detector = Callable[[Recordings], Iterable[Problem]]
# A check of errors, and those that only warn.
type Stage = tuple[Detector, tuple[Detector, ...]]

# An impact with an error that one stage finds is not asked the next: it would only raise a false alarm.
OF_SAMPLES: tuple[Stage, ...] = ((_sample_problems, ()), (_clock_problems, ()))
OF_MOVEMENT: Stage = (_movement_problems, (recording_twice, _movement_warnings))


def check_recordings(
    recordings: Recordings, stages: Iterable[Stage] = (*OF_SAMPLES, OF_MOVEMENT)
) -> Recordings:
    """The recordings with nothing wrong, with what is wrong with the others and what only looks odd.

    Errors: samples that are no numbers; fewer than 8 of them; time that stands still or runs back, or, of
    displacements and behind a declared low-pass, strays from even spacing by more than a tenth of a step; a
    stated sampling rate more than 1 % off; steps too long or recordings too short for an impact, as a wrong
    unit of time makes them; and movements that can't be right.

    Args:
        recordings: of whatever quantity.
        stages: the checks; of samples and clocks alone those of ``OF_SAMPLES``.
    """
    problems, warnings = list(recordings.problems), list(recordings.warnings)
    with np.errstate(all="ignore"):
        for find, find_odd in stages:
            problems += find(recordings)
            warnings += chain.from_iterable(odd(recordings) for odd in find_odd)
            recordings = recordings.without(problems)
            if not len(recordings):
                break
    return replace(recordings, problems=problems, warnings=warnings)
