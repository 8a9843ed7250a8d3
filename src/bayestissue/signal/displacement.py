"""From recorded impacts to the displacements that an estimate uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from bayestissue.dataset.model import Dataset
from bayestissue.errors import Coded
from bayestissue.signal.beyond_limit import beyond_limit
from bayestissue.signal.contact import Onset, displacement_contact, find_onset, motion_of
from bayestissue.signal.filters import ahead_s
from bayestissue.signal.integration import Rule, clear_velocity, cumulative, derivatives
from bayestissue.signal.options import SignalOptions
from bayestissue.signal.phase import BETWEEN, ContactEvidence, Phase, phase_of
from bayestissue.signal.settings import CONTACT, WINDOW
from bayestissue.signal.start import Start, find_start
from bayestissue.signal.traces import (
    Column,
    Index,
    Mask,
    Recordings,
    Rows,
    at,
    from_sample,
    noise_sd,
)
from bayestissue.signal.window import Stop, samples_in, slowest, still_pushed, zero_velocity

FEWEST_SAMPLES = 8
TOO_FEW = Coded(f"fewer than {FEWEST_SAMPLES} samples in the window", "too-few-samples")
NO_CONTACT = Coded("no contact was found: the signal drifts from its beginning on", "drift")
UNEVEN = Coded("times are uneven: each sample is taken at its own", "uneven-times")
LONGER = Coded("few samples below the sensor's limit: the window goes on to the rebound", "clipped")
SLOWLY = Coded("few samples until zero velocity: the window goes on to the rebound", "few-samples")
NO_OFFSET = Coded("no quiet part before contact: no offset was removed", "no-quiet-part")
ON_SAMPLE = Coded("contact is taken to be at a sample", "contact-on-sample")
NOT_ON_SAMPLE = Coded(
    "contact is declared to be at a sample: the recordings contradict it", "contact-between"
)
BELOW_ZERO = Coded(
    "stays below zero, where contact is: the sensor has another zero (write signal.offset)", "starts-deep"
)
# Samples before contact that are kept, at the most.
BEFORE = 60


@dataclass(frozen=True)
class Displacements:
    """Displacements of all impacts over their windows, in SI units.

    Attributes:
        x: [impact, sample], m, since contact; 0 past a row's end.
        v: [impact, sample], velocity, m/s.
        deceleration: [impact, sample], m/s², offset removed; along gravity force over mass.
        n_samples: [impact], samples in the window.
        dt: [impact], sampling interval, s; of uneven times the mean one.
        sample_number: [impact, sample], times of x since the first sample, in sampling intervals: 0, 1, 2 and
            so on where times are even, else between whole numbers.
        uneven: [impact], whether times are uneven.
        clipped: [impact, sample], 1 where the deceleration stands at the sensor's upper limit, -1 at its
            lower one, else 0; x and v are then of a deceleration that goes on beyond.
        mass: [impact], kg.
        velocity: [impact], at contact, m/s.
        gravity: [impact], along the motion, m/s².
        contact_time_s: [impact], on the recording's own clock.
        contact_time_sd: [impact], s; 0 where contact was given.
        first_sample_s: [impact], time from contact to the first sample of x, s.
        bracket_s, bracket_sd: [impact], the same and its standard deviation, s, before the samples in contact
            were asked: what a model of those samples themselves may start from.
        bracket_uniform: [impact], whether contact may then have been at any moment between two samples.
        interval_s: [impact], the sampling interval that contact falls in; 0 where that is not known.
        time_to_peak: [impact], from contact to zero velocity, s.
        peak_displacement: [impact], at zero velocity, since contact, m.
        offset: [impact], what was subtracted from the recording, in its own SI unit.
        offset_sd: [impact], standard error of that, from the noise of the quiet part; NaN where nothing was
            subtracted.
        noise_sd: [impact], standard deviation of the recording's white noise, same unit.
        before: [impact, `BEFORE`], the last samples before the first one of x, offset removed, m/s²; 0 where
            there are none, as of a recorded displacement.
        before_s: [impact, `BEFORE`], when these were, since the first sample of x, negative, s.
        n_before: [impact], how many of these there are.
        n_since_quiet: [impact], how many of these at most are later than the quiet part whose mean was
            subtracted; all where there was none.
        reach_s: [impact], for how long before the first sample a force that rises from 0 may have acted
            without showing, s; 0 where contact was given.
        blurred: [impact], where noise hides a jump of the force too: contact was looked for in means.
        flags: per impact, what is wrong with it.
        notes: per impact, what is not wrong, but should be known.
        phase: where contact falls within a sampling interval.
    """

    x: Rows
    v: Rows
    deceleration: Rows
    n_samples: Index
    dt: Column
    sample_number: Rows
    uneven: Mask
    clipped: Rows
    mass: Column
    velocity: Column
    gravity: Column
    contact_time_s: Column
    contact_time_sd: Column
    first_sample_s: Column
    bracket_s: Column
    bracket_sd: Column
    bracket_uniform: Mask
    interval_s: Column
    time_to_peak: Column
    peak_displacement: Column
    offset: Column
    offset_sd: Column
    noise_sd: Column
    before: Rows
    before_s: Rows
    n_before: Index
    n_since_quiet: Index
    reach_s: Column
    blurred: Mask
    flags: list[list[Coded]]
    notes: list[list[Coded]]
    phase: Phase = BETWEEN

    @property
    def n_below_limit(self) -> Index:
        """[impact], samples in the window that are not at the sensor's limit."""
        return self.n_samples - (self.clipped != 0).sum(axis=1)

    def zero_sd(self, declared: float | Column) -> Column:
        """[impact], of the zero's error: of the quiet part whose mean was subtracted, else as declared."""
        return np.where(np.isfinite(self.offset_sd), self.offset_sd, declared)

    @property
    def since_contact_s(self) -> Rows:
        """[impact, sample], when each sample of x was, s."""
        return self.first_sample_s[:, None] + self.sample_number * self.dt[:, None]


def displacements(
    dataset: Dataset, options: SignalOptions | None = None, rule: Rule = "quintic"
) -> Displacements:
    """The displacement of every impact, from contact over the window that the options choose.

    v(t) = V − ∫(d − g) and x(t) = ∫v from contact on (thesis, section 2.2), g being gravity along the motion;
    recorded displacements are taken as they are, from their value at contact. The samples of x are the
    recorder's own: the first one lies up to one interval after contact, where x is already above 0.

    Args:
        dataset: the recordings.
        options: where contact is, and how far the window goes.
        rule: of both integrations; the thesis's is trapezoidal.
    """
    options = options or SignalOptions()
    mass, velocity = (dataset.impacts[name].to_numpy(dtype=float) for name in ("mass_kg", "velocity_m_s"))
    gravity = np.full(len(mass), dataset.gravity)
    blocks = _blocks(len(mass), max(len(trace.value) for trace in dataset.traces))

    def met(rows: slice) -> _Met:
        recorded = motion_of(dataset.traces[rows], dataset.quantity)
        recorded = replace(recorded, ahead_s=float(ahead_s(dataset.recorder, recorded.dt).max()))
        return _Met(recorded, mass[rows], velocity[rows], gravity[rows])

    if dataset.quantity == "displacement":
        return _joined([_recorded(met(rows), options) for rows in blocks])
    signals, evidence = zip(*(_integrated(met(rows), options, rule) for rows in blocks), strict=True)
    if dataset.recorder is not None:
        # No force jumps behind a low-pass, and contact has no interval of its own.
        return _joined(signals)
    sd = np.hypot(dataset.uncertainty.velocity_sd_m_s / velocity, dataset.uncertainty.relative_gain_sd)
    of_all = ContactEvidence(*map(np.concatenate, zip(*evidence, strict=True)))
    phase = phase_of(of_all, sd, dataset.contact)
    if phase.known:
        signals = tuple(_integrated(met(rows), options, rule, phase)[0] for rows in blocks)
    signal = _joined(signals)
    of_phase = [ON_SAMPLE] * (phase.known and phase.judged) + [NOT_ON_SAMPLE] * phase.contradicted
    return replace(signal, phase=phase, notes=[row + of_phase for row in signal.notes])


class _Met(NamedTuple):
    """Recordings under one another, and of each the mass (kg), its velocity (m/s) and gravity (m/s²)."""

    recordings: Recordings
    mass: Column
    velocity: Column
    gravity: Column


def _integrated(
    met: _Met, options: SignalOptions, rule: Rule, phase: Phase = BETWEEN
) -> tuple[Displacements, ContactEvidence]:
    recordings, mass, velocity, gravity = met
    onset = find_onset(recordings, options)
    part = from_sample(recordings, onset.first)
    part = replace(part, value=part.value - onset.offset[:, None])
    recorded, clipped, bracket = part.value, np.zeros_like(part.value), (onset.least, onset.most)
    if recordings.clipped is not None:
        clipped = from_sample(replace(recordings, value=recordings.clipped), onset.first).value
        part = replace(part, value=beyond_limit(part, clipped, velocity, gravity, bracket))
    d, inside, dt = part.value, part.inside, part.dt
    slowing = replace(part, value=d - gravity[:, None])
    first = cumulative(slowing, rule)
    second = cumulative(replace(part, value=first), rule)
    bracketed = (onset.most > onset.least) & (onset.most < 1.5 * dt) & ~onset.blurred & ~part.uneven
    known = np.where(bracketed, phase.place * dt, np.nan)
    start = find_start(part, (first, second), velocity, gravity, bracket, known)
    v = start.v[:, None] - first
    x = start.x[:, None] + start.v[:, None] * part.time_s - second
    # The last sample clear of great noise is one that the noise has lifted.
    pushed = inside & (still_pushed(part, onset.noise_sd) | onset.blurred[:, None])
    stop = zero_velocity(slowing, v, x, pushed, velocity)
    contact_words = "contact as chosen is more than 1 ms from where the trace shows it"
    flags = {
        Coded("velocity does not reach zero", "no-zero-velocity"): ~stop.reached,
        Coded(contact_words, "contact-doubtful"): onset.doubtful,
        NO_CONTACT: ~onset.quiet & (onset.first >= CONTACT.quiet_samples),
    }
    signal = _windowed(
        part, (x, v, d if recordings.clipped is None else recorded), clipped, stop, start, options, flags,
        {NO_OFFSET: ~onset.quiet, UNEVEN: part.uneven},
        mass=mass, velocity=velocity, gravity=gravity, offset=onset.offset,
        offset_sd=np.where(onset.quiet, onset.offset_sd, np.nan), noise_sd=onset.noise_sd,
        interval_s=np.where(bracketed, dt, 0.0), **_before(recordings, onset),
    )  # fmt: skip
    # Beyond the sensor's limit a trace is what a spring and damper makes of it: it tells nothing of contact.
    bracketed &= (clipped == 0).all(axis=1)
    # Nor does one that begins with its greatest force, of heavily damped tissue: what falls from there on
    # falls the same way whenever it began, and least squares have too small an error.
    bracketed &= d[:, 0] < CONTACT.most_jump * np.where(inside, d, 0.0).max(axis=1)
    at_zero = np.abs(part.start[:, None] - np.array([0.0, 1.0]) * dt[:, None]) < 1e-6 * dt[:, None]
    return signal, ContactEvidence(start.free, start.free_sd, start.by_velocity, dt, bracketed, at_zero)


def _before(recordings: Recordings, onset: Onset) -> dict[str, Any]:
    """What was recorded before the first sample in contact: see `Displacements`."""
    index = onset.first[:, None] - BEFORE + np.arange(BEFORE)
    value = np.take_along_axis(recordings.value, np.maximum(index, 0), axis=1) - onset.offset[:, None]
    since_first = recordings.sample_number_of(index) - recordings.sample_number_of(onset.first)[:, None]
    return {
        "before": np.where(index >= 0, value, 0.0),
        "before_s": since_first * recordings.dt[:, None],
        "n_before": np.minimum(onset.first, BEFORE),
        "n_since_quiet": onset.first - np.where(onset.quiet, onset.quiet_samples, 0),
        "reach_s": onset.reach,
        "blurred": onset.blurred,
    }


def _recorded(met: _Met, options: SignalOptions) -> Displacements:
    """Of recorded displacements."""
    recordings, mass, velocity, gravity = met
    noise = noise_sd(recordings)
    first, since_contact = displacement_contact(recordings, options)
    share = since_contact / recordings.dt
    level = at(recordings.value, first)
    at_contact = np.where(first > 0, level - share * (level - at(recordings.value, first - 1)), level)
    part = from_sample(recordings, first)
    velocities, curvatures = derivatives(recordings)
    clear = clear_velocity(recordings, velocities, noise)
    v, d, clear = (
        from_sample(replace(recordings, value=rows), first).value for rows in (velocities, curvatures, clear)
    )
    velocity = np.where(np.isfinite(velocity), velocity, v[:, 0])
    x = part.value - at_contact[:, None]
    stop = slowest(replace(part, value=x), clear, velocity)
    slowest_words = "velocity does not reach zero: the window ends where it is least"
    greatest = np.where(recordings.inside, recordings.value, -np.inf).max(axis=1)
    below = (greatest <= 0) & (options.contact != "time-zero")
    flags = {BELOW_ZERO: below, Coded(slowest_words, "no-zero-velocity"): ~stop.reached & ~below}
    sd = np.where(options.contact == "time-zero", 0, noise / np.maximum(velocity, 1e-12))
    nothing, known = np.zeros_like(sd), np.zeros(len(sd), bool)
    free = (since_contact, sd, nothing)
    start = Start(since_contact, sd, since_contact, sd, known, *free, x[:, 0], v[:, 0])
    return _windowed(
        part, (x, v, d), np.zeros_like(x), stop, start, options, flags, {},
        mass=mass, velocity=velocity, gravity=gravity, offset=at_contact, offset_sd=nothing * np.nan,
        noise_sd=noise, interval_s=nothing, before=np.zeros((len(sd), BEFORE)),
        before_s=np.zeros((len(sd), BEFORE)), n_before=nothing.astype(int),
        n_since_quiet=nothing.astype(int), reach_s=nothing, blurred=nothing.astype(bool),
    )  # fmt: skip


def _windowed(
    part: Recordings,
    motion: tuple[Rows, Rows, Rows],
    clipped: Rows,
    stop: Stop,
    start: Start,
    options: SignalOptions,
    flags: dict[Coded, Mask],
    notes: dict[Coded, Mask],
    **columns: Any,
) -> Displacements:
    """The motion (x, v and deceleration) over the window; ``columns`` are attributes as they are."""
    x, _, deceleration = motion
    since_contact, noise = start.since_contact, columns["noise_sd"]
    moved = since_contact, replace(part, value=deceleration), x, noise
    n = samples_in(options.window, stop, *moved)
    at_limit = clipped != 0
    below = (at_limit[:, : int(n.max())] & (np.arange(int(n.max())) < n[:, None])).sum(axis=1)
    longer = at_limit.any(axis=1) & (n - below < WINDOW.few_below)
    slowly = ~longer & (n - below < FEWEST_SAMPLES) & (options.window == "peak") & stop.reached
    if (longer | slowly).any():
        # What the sensor did not see on the way in stands on the way back.
        n = np.where(longer | slowly, np.maximum(n, samples_in("rebound", stop, *moved)), n)
    used = np.arange(int(n.max())) < n[:, None]
    few = n - (used & at_limit[:, : used.shape[1]]).sum(axis=1) < FEWEST_SAMPLES
    drifts = few & flags.get(NO_CONTACT, False)
    x, v, deceleration, clipped = (np.where(used, rows[:, : used.shape[1]], 0) for rows in (*motion, clipped))
    return Displacements(
        x=x,
        v=v,
        deceleration=deceleration,
        n_samples=n,
        dt=part.dt,
        sample_number=part.sample_numbers[:, : used.shape[1]],
        uneven=part.uneven,
        clipped=clipped,
        contact_time_s=part.start - since_contact,
        contact_time_sd=start.since_contact_sd,
        first_sample_s=since_contact,
        bracket_s=start.bracket,
        bracket_sd=start.bracket_sd,
        bracket_uniform=start.bracket_uniform,
        time_to_peak=since_contact + stop.time,
        peak_displacement=stop.x,
        flags=_raised({**flags, NO_CONTACT: drifts, TOO_FEW: few & ~drifts}, len(n)),
        notes=_raised({**notes, LONGER: longer, SLOWLY: slowly & ~few}, len(n)),
        **columns,
    )


def _raised(words: dict[Coded, Mask], count: int) -> list[list[Coded]]:
    return [[text for text, up in words.items() if up[row]] for row in range(count)]


def _blocks(count: int, longest: int) -> list[slice]:
    """Of ``count`` impacts so many at a time that arrays of ``longest`` samples each stay small."""
    size = max(1, WINDOW.block // longest)
    return [slice(begin, begin + size) for begin in range(0, count, size)]


def _joined(parts: Sequence[Displacements]) -> Displacements:
    """The impacts of all parts; the phase is that of none of them."""
    if len(parts) == 1:
        return parts[0]
    names = [field.name for field in fields(Displacements) if field.name != "phase"]
    return Displacements(**{name: _end_to_end([getattr(part, name) for part in parts]) for name in names})


def _end_to_end(parts: list[Any]) -> Any:
    """Lists, columns, or rows of which shorter ones are filled up with 0."""
    if isinstance(parts[0], list):
        return [row for part in parts for row in part]
    if parts[0].ndim == 2:
        width = max(part.shape[1] for part in parts)
        parts = [np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in parts]
    return np.concatenate(parts)
