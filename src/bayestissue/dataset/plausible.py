"""Whether a recording can be that of an impact on tissue: its sign, size, length and greatest value."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayestissue.dataset.motion import Motion, flat_top
from bayestissue.dataset.recordings import Recordings
from bayestissue.dataset.settings import FILE as SETTINGS
from bayestissue.errors import Problem

MIN_SAMPLES = 8
FLAT_SAMPLES = 4
FALL_WITHIN = 0.05
# The answer of a low-pass of the second order to the shortest blow of all rises for 0.17 over its corner.
_SLOWEST = 0.15
# Of the greatest value: a recording that ends below it shows the whole force.
_FORCE_IS_GONE = 0.1
# An impact on tissue lasts some hundredths of a second: longer steps hold no eight samples of it.
LONGEST_STEP_S = 0.02
SHORTEST_S = 1e-4
DEEPEST_M = 1.0
# Mean speed from a twentieth of the greatest displacement to the greatest, over that at contact.
_MEAN_SPEED = (0.03, 3.0)


def clock_problems(recordings: Recordings) -> Iterator[Problem]:
    """Recordings that are too slow or too short for an impact: their unit of time is wrong."""
    samples = recordings.samples
    begin, end = samples.start[:-1], samples.start[1:]
    lasts = samples.time[end - 1] - samples.time[begin]
    step = lasts / (samples.count - 1)
    remedy = "Check signal.time_unit in dataset.toml, and sampling_rate_hz."
    for which in np.flatnonzero(step > LONGEST_STEP_S):
        yield recordings.problem(
            which,
            f"a sample at least every {LONGEST_STEP_S:g} s, for an impact lasts some hundredths",
            remedy,
            value=f"one every {step[which]:.4g} s",
            column=samples.time_column,
            code="unit",
        )
    for which in np.flatnonzero((lasts > 0) & (lasts < SHORTEST_S)):
        yield recordings.problem(
            which,
            f"a recording of at least {SHORTEST_S:g} s",
            remedy,
            value=f"one of {lasts[which]:.4g} s",
            column=samples.time_column,
            code="unit",
        )


def movement_problems(recordings: Recordings, moving: Motion) -> list[Problem]:
    """Recordings that can't be right.

    A channel that never changes; fewer than 8 samples above a tenth of the greatest deceleration; four or
    more samples at one extreme value and hardly any just below it (a recorder's limit). For decelerations
    also: an impactor that gains speed (the sign is wrong), one that loses more than three times the speed it
    came with (a unit is wrong), and a recording that ends before it has lost that speed, 5 %, one sample and
    three standard deviations of gain, velocity and offset allowed for. Once for all impacts, a declared
    low-pass that is far too slow for the median of them, or a digital one that their samples can't have. For
    displacements: one that goes down where it should go into the tissue, deeper than a metre, or at
    quite another speed than that at contact.
    """
    problems = [*_dead(recordings, moving), *_coarse(recordings, moving), *_clipped(recordings, moving)]
    problems += _impossible_low_pass(recordings, moving)
    if recordings.quantity == "displacement":
        return [*problems, *_wrong_way(recordings, moving), *_depths(recordings, moving)]
    return [*problems, *_speeds(recordings, moving)]


def movement_warnings(recordings: Recordings, moving: Motion) -> list[Problem]:
    """Recordings that look odd.

    A displacement that still grows when the recording ends; an impactor that loses more than 2.5 times the
    speed it came with.
    """
    particular = _still_sinking if recordings.quantity == "displacement" else _fast
    return list(particular(recordings, moving))


def _dead(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    for which in np.flatnonzero(moving.high == moving.low):
        yield recordings.problem(
            which,
            "a signal that changes",
            "Check which channel was exported.",
            value=f"{moving.high[which]:g} in every sample",
            code="constant-signal",
        )


def _coarse(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    for which in np.flatnonzero((moving.pulse < MIN_SAMPLES) & (moving.high > moving.low)):
        yield recordings.problem(
            which,
            f"at least {MIN_SAMPLES} samples above a tenth of the greatest deceleration",
            "Record at a higher rate, or check that this is an impact.",
            value=f"{moving.pulse[which]} samples",
            code="narrow-peak",
        )


def _clipped(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    samples, quantity = recordings.samples, recordings.quantity
    for which, at, count, top in flat_top(samples, moving, quantity, FLAT_SAMPLES):
        yield recordings.problem(
            which,
            "a peak below the recorder's limit",
            "Record again with a wider range, or take the impact out: what lies above the limit is lost.",
            value=f"{count} samples at {top:g}",
            at=at,
            code="clipped",
        )


def _impossible_low_pass(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    rise = moving.rise[moving.rise > 0]
    if recordings.recorder is None or not rise.size:
        return
    corner, typical = recordings.recorder.low_pass_hz, float(np.median(rise))
    samples = recordings.samples
    lasts = samples.time[samples.start[1:] - 1] - samples.time[samples.start[:-1]]
    rate = float(((samples.count - 1) / lasts).min())
    if recordings.recorder.digital and corner >= rate / 2:
        yield Problem(
            SETTINGS,
            f"a digital low-pass below {rate / 2:g} Hz, half of the sampling rate",
            'Look up its corner, or write applied = "analog" if it acted before sampling or on more samples.',
            column="recorder.sae_class" if recordings.recorder.sae_class else "recorder.low_pass_hz",
            value=f"{corner:g} Hz",
            code="impossible-low-pass",
        )
    elif corner * typical < _SLOWEST:
        yield Problem(
            SETTINGS,
            f"a low-pass that recordings can have passed which peak {1e3 * typical:.3g} ms (median) after "
            f"their rise began: about {1 / typical:.2g} Hz, and no less than {_SLOWEST / typical:.2g} Hz",
            "Look up the corner of sensor, amplifier and recorder, in Hz, or take [recorder] out.",
            column="recorder.low_pass_hz",
            value=f"{corner:g} Hz",
            code="impossible-low-pass",
        )


def _wrong_way(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    for which in np.flatnonzero(moving.extreme < 0):
        yield recordings.problem(
            which,
            "a displacement that grows as the impactor goes into the tissue",
            "Write a negative signal.scale in dataset.toml if the recorder counts the other way.",
            value=f"{moving.extreme[which]:g} m from the first sample",
            code="sign",
        )


def _depths(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    samples, velocity = recordings.samples, recordings.velocity
    for which in np.flatnonzero(moving.extreme > DEEPEST_M):
        yield recordings.problem(
            which,
            f"a displacement below {DEEPEST_M:g} m",
            "Check signal.unit and signal.scale in dataset.toml.",
            value=f"{moving.extreme[which]:.4g} m",
            code="unit",
        )
    for which in np.flatnonzero((moving.extreme > 0) & (moving.extreme <= DEEPEST_M) & (velocity > 0)):
        mine = slice(samples.start[which], moving.peak[which] + 1)
        displaced = samples.value[mine] - samples.value[mine.start]
        shallow = int(np.flatnonzero(displaced <= FALL_WITHIN * displaced[-1])[-1])
        lasts = samples.time[moving.peak[which]] - samples.time[mine][shallow]
        speed = (displaced[-1] - displaced[shallow]) / lasts
        low, high = _MEAN_SPEED
        if not low < speed / velocity[which] < high:
            yield recordings.problem(
                which,
                f"a displacement that grows at a speed like the {velocity[which]:.4g} m/s at contact",
                "Check signal.unit, signal.time_unit and signal.scale, and the velocity in impacts.csv.",
                value=f"{speed:.4g} m/s on average",
                code="velocity-off",
            )


def _still_sinking(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    for which in np.flatnonzero((moving.extreme > 0) & (moving.peak >= recordings.samples.start[1:] - 2)):
        yield recordings.problem(
            which,
            "a recording that goes on past the greatest displacement",
            "Zero velocity may lie beyond the end of the recording.",
            value="the greatest displacement at the end",
            code="ends-early",
        )


def _speeds(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    velocity, uncertainty = recordings.velocity, recordings.uncertainty
    known = np.isfinite(velocity) & (moving.high > moving.low)
    allowed = FALL_WITHIN + 3 * (uncertainty.relative_gain_sd + uncertainty.velocity_sd_m_s / velocity)
    # Contact may precede the first sample by an interval, and its jump may be as high as the peak.
    allowed += (moving.step_loss + 3 * uncertainty.offset_sd * moving.duration) / velocity
    faster = known & (moving.gain > 0.5 * velocity) & (moving.gain > moving.loss)
    short = known & ~faster & (moving.loss < velocity * (1 - np.minimum(allowed, 0.9)))
    absurd = known & ~faster & ~(moving.pulse_loss <= 3 * velocity)
    for which in np.flatnonzero(faster):
        yield recordings.problem(
            which,
            "an impactor that slows down",
            'Is signal.quantity right? An "acceleration" is the negative of a "deceleration".',
            value=f"a speed that grows by {moving.gain[which]:.4g} m/s",
            code="sign",
        )
    # A recording that goes on until the force is gone has not ended early.
    samples = recordings.samples
    last = np.abs(samples.value[samples.start[1:] - 1])
    gone = last < _FORCE_IS_GONE * np.maximum(np.abs(moving.high), np.abs(moving.low))
    for which in np.flatnonzero(short & gone):
        yield recordings.problem(
            which,
            f"a speed that falls by at least the {velocity[which]:.4g} m/s at contact",
            "Check signal.unit (m/s^2 or g?), time_unit and scale, and the velocity in impacts.csv.",
            value=f"a speed that falls by {moving.loss[which]:.4g} m/s",
            code="velocity-off",
        )
    for which in np.flatnonzero(short & ~gone):
        yield recordings.problem(
            which,
            f"a recording until zero velocity: the speed must fall by {velocity[which]:.4g} m/s",
            "Export a longer recording; check signal.unit, time_unit, scale and the velocity too.",
            value=f"a speed that falls by {moving.loss[which]:.4g} m/s",
            code="ends-early",
        )
    for which in np.flatnonzero(absurd):
        yield recordings.problem(
            which,
            f"a speed that falls by no more than twice the {velocity[which]:.4g} m/s at contact",
            "Check signal.unit, time_unit and scale, and the velocity in impacts.csv.",
            value=f"a speed that falls by {moving.pulse_loss[which]:.4g} m/s",
            code="velocity-off",
        )


def _fast(recordings: Recordings, moving: Motion) -> Iterator[Problem]:
    velocity = recordings.velocity
    odd = (moving.loss > 2.5 * velocity) & (moving.pulse_loss <= 3 * velocity)
    for which in np.flatnonzero(odd):
        yield recordings.problem(
            which,
            f"a speed that falls by no more than twice the {velocity[which]:.4g} m/s at contact",
            "Has the recorder an offset? Check signal.offset, signal.unit and the velocity.",
            value=f"a speed that falls by {moving.loss[which]:.4g} m/s",
            code="velocity-off",
        )
