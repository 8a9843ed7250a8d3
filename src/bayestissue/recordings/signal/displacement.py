"""From recorded impacts to the displacements that an estimate uses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from bayestissue.base.errors import Coded, by_impact
from bayestissue.recordings.dataset.dataset_file import STANDARD_GRAVITY, LowPassFilter, Quantity
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.dataset.ragged_traces import Trace, Traces
from bayestissue.recordings.signal.contact import (
    Onset,
    QuietPart,
    displacement_contact,
    find_onset,
)
from bayestissue.recordings.signal.integrals import Rule, clear_velocity, cumulative, derivatives
from bayestissue.recordings.signal.padded_traces import (
    Column,
    ImpactTraces,
    Index,
    Mask,
    PaddedTraces,
    Rows,
    at,
    first_where,
    from_sample,
    last_where,
    noise_sd,
    samples_before,
    stack,
)
from bayestissue.recordings.signal.phase import BETWEEN, Phase, phase_of
from bayestissue.recordings.signal.signal_settings import CONTACT, WINDOW, SignalOptions, Window
from bayestissue.recordings.signal.start import Start, beyond_limit, find_start

FEWEST_SAMPLES = 8
TOO_FEW = Coded.stated("too-few-samples", fewest=FEWEST_SAMPLES)
NO_CONTACT = Coded.stated("drift.contact")
SLOWLY = Coded.stated("few-samples")
NOT_ON_SAMPLE = Coded.stated("contact-between")
BELOW_ZERO = Coded.stated("starts-deep.below")
# Samples before contact that are kept, at the most.
BEFORE = 60


class Stop(NamedTuple):
    """Zero velocity: the first sample at or past it, its time since the first sample (s), and x there (m).

    Where the velocity does not reach zero before the tissue stops pushing, the last sample until then stands
    in; ``reached`` is false unless hardly any velocity is left there.
    """

    sample: Index
    time: Column
    x: Column
    reached: Mask


class Before(NamedTuple):
    """What was recorded before the first sample in contact; nothing of a recorded displacement.

    Attributes:
        value: [impact, `BEFORE`], the last samples before that one, offset removed, m/s²; 0 where there are
            none.
        time_s: [impact, `BEFORE`], when these were, since that one, negative, s.
        n_samples: [impact], how many of these there are.
        n_since_quiet: [impact], how many of these at most are later than the quiet part whose mean was
            subtracted; all where there was none.
        reach_s: [impact], for how long before that sample a force that rises from 0 may have acted without
            showing, s; 0 where contact was given.
        blurred: [impact], where noise hides a jump of the force too: contact was looked for in means.
    """

    value: Rows
    time_s: Rows
    n_samples: Index
    n_since_quiet: Index
    reach_s: Column
    blurred: Mask

    @classmethod
    def of(cls, recordings: ImpactTraces, onset: Onset) -> Before:
        """By the whole recordings."""
        index = onset.first[:, None] - BEFORE + np.arange(BEFORE)
        value = np.take_along_axis(recordings.value, np.maximum(index, 0), axis=1)
        since_first = recordings.sample_number_of(index) - recordings.sample_number_of(onset.first)[:, None]
        return cls(
            np.where(index >= 0, value - onset.quiet.offset[:, None], 0.0),
            since_first * recordings.dt[:, None],
            np.minimum(onset.first, BEFORE),
            onset.first - onset.quiet.samples,
            onset.reach,
            onset.blurred,
        )


@dataclass(frozen=True, kw_only=True)
class Displacements(ImpactTraces):
    """Decelerations of impacts from their first sample in contact on, and the motion that they give.

    Of the traces, ``value`` is the deceleration, offset removed, m/s²; along gravity force over mass. Past a
    row's end all are 0.

    Attributes:
        x: [impact, sample], m, since contact; that of a deceleration that goes on beyond the sensor's limit.
        v: [impact, sample], velocity, m/s, of the same.
        contact: when that was, before the first sample.
        stop: zero velocity.
        quiet: zero and noise of the recording.
        before: the samples before the first one.
        flags: per impact, what is wrong with it.
        notes: per impact, what is not wrong, but should be known.
        phase: where contact falls within a sampling interval.
    """

    x: Rows
    v: Rows
    contact: Start
    stop: Stop
    quiet: QuietPart
    before: Before
    flags: list[list[Coded]] = field(default_factory=list)
    notes: list[list[Coded]] = field(default_factory=list)
    phase: Phase = BETWEEN

    @property
    def deceleration(self) -> Rows:
        """[impact, sample], m/s²."""
        return self.value

    @property
    def n_below_limit(self) -> Index:
        """[impact], samples that are not at the sensor's limit."""
        return self.n_samples - self.at_limit.sum(axis=1)

    @property
    def contact_time_s(self) -> Column:
        """[impact], on the recording's own clock."""
        return self.start - self.contact.since_s

    @property
    def since_contact_s(self) -> Rows:
        """[impact, sample], when each sample was, s."""
        return self.contact.since_s[:, None] + self.time_s

    @property
    def time_to_peak(self) -> Column:
        """[impact], from contact to zero velocity, s."""
        return self.contact.since_s + self.stop.time

    def impacts(self, rows: Int[np.ndarray, " row"]) -> Displacements:
        """Those of these rows."""

        def chosen(whole: Any) -> Any:
            return [whole[row] for row in rows] if isinstance(whole, list) else whole[rows]

        return _joined([self], chosen)

    def samples_in(self, window: Window) -> Index:
        """How many samples from the first one on lie in the window.

        rebound ends where, after zero velocity, d falls below 2 % of its peak or three noise standard
        deviations (the tissue no longer pushes) or x is back at 0.
        """
        d, inside = self.value, self.inside
        if window == "rebound":
            floor = np.maximum(0.02 * self.filled(0).max(axis=1), 3 * self.quiet.noise_sd)
            over = (d <= floor[:, None]) | (self.x <= 0)
            return first_where(over & inside & ~samples_before(d, self.stop.sample), self.n_samples)
        fraction, since_contact = 1.0 if window == "peak" else float(window), self.contact.since_s
        until = fraction * (since_contact + self.stop.time) - since_contact
        return np.sum(inside & (self.time_s <= (until + 1e-9 * self.dt)[:, None]), axis=1)

    def over_window(
        self, options: SignalOptions, flags: dict[Coded, Mask], notes: dict[Coded, Mask]
    ) -> Displacements:
        """The same over the window that the options choose, with flags and notes, those of the window too."""
        n = self.samples_in(options.window)

        def below_limit(n: Index) -> Index:
            return (samples_before(self.clipped, n) & ~self.at_limit).sum(axis=1)

        longer = self.limited & (below_limit(n) < WINDOW.few_below)
        slowly = ~longer & (below_limit(n) < FEWEST_SAMPLES) & (options.window == "peak") & self.stop.reached
        if (longer | slowly).any():
            # What the sensor did not see on the way in stands on the way back.
            n = np.where(longer | slowly, np.maximum(n, self.samples_in("rebound")), n)
        used = np.arange(int(n.max())) < n[:, None]
        few = below_limit(n) < FEWEST_SAMPLES
        drifts = few & flags.get(NO_CONTACT, False)
        rows: Any = {"x": self.x, "v": self.v, "value": self.value, "clipped": self.clipped}
        rows = {name: np.where(used, values[:, : used.shape[1]], 0) for name, values in rows.items()}
        return replace(
            self,
            **rows,
            n_samples=n,
            sample_number=self.sample_numbers[:, : used.shape[1]],
            flags=by_impact({**flags, NO_CONTACT: drifts, TOO_FEW: few & ~drifts}, len(n)),
            notes=by_impact({**notes, Coded.stated("clipped.few"): longer, SLOWLY: slowly & ~few}, len(n)),
        )


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
    # So many at a time that arrays of all their samples stay small.
    size = max(1, WINDOW.block // max(len(trace.value) for trace in dataset.traces))
    blocks = [slice(begin, begin + size) for begin in range(0, len(mass), size)]

    def met(rows: slice) -> ImpactTraces:
        traces = motion_of(dataset.traces[rows], dataset.quantity)
        return ImpactTraces(**vars(traces), mass=mass[rows], velocity=velocity[rows], gravity=gravity[rows])

    if dataset.quantity == "displacement":
        return _joined([_recorded(met(rows), options) for rows in blocks])
    chosen = dataset.recorder, options, rule
    signals, tell = zip(*(_integrated(met(rows), *chosen) for rows in blocks), strict=True)
    signal, sd = _joined(signals), dataset.uncertainty.of_velocity(velocity)
    if dataset.recorder is not None:
        # No force jumps behind a low-pass, and contact has no interval of its own.
        return signal
    phase = phase_of(signal, np.concatenate(tell), sd, dataset.contact)
    if phase.known:
        signal = _joined([_integrated(met(rows), *chosen, phase)[0] for rows in blocks])
    of_phase = [Coded.stated("contact-on-sample")] * (phase.known and phase.judged)
    of_phase += [NOT_ON_SAMPLE] * phase.contradicted
    return replace(signal, phase=phase, notes=[row + of_phase for row in signal.notes])


def motion_of(traces: Sequence[Trace], quantity: Quantity) -> PaddedTraces:
    """The recordings of these traces, positive while the impactor slows, from its release on."""
    slowing = stack(Traces.of(traces).slowing(quantity))
    return slowing if quantity == "displacement" else since_release(slowing)


def since_release(recordings: PaddedTraces) -> PaddedTraces:
    """Each recording from where its impactor falls freely, if it was held before; else as it is.

    What is held reads one g more than what falls, whatever the zero: most of the samples before the lowest
    level ahead of the peak do. Noise that hides such a step hides what was held.
    """
    g, value, index = STANDARD_GRAVITY, recordings.value, np.arange(recordings.value.shape[1])
    peak = np.argmax(recordings.filled(-np.inf), axis=1)
    size = min(CONTACT.quiet_samples, len(index))
    means = np.lib.stride_tricks.sliding_window_view(value, size, axis=1).mean(axis=-1)
    ahead = index[: means.shape[1]] < (peak - size)[:, None]
    lowest = np.argmin(np.where(ahead, means, np.inf), axis=1)
    high = (value > (at(means, lowest) + g / 2)[:, None]) & (index <= lowest[:, None])
    last = np.maximum(last_where(high), 0)
    held, until_peak = index <= last[:, None], index <= np.maximum(peak, last + 1)[:, None]
    level = np.nanmedian(np.where(held, value, np.nan), axis=1)
    # The lower quartile: letting go may ring, and the peak's foot is no free fall.
    falls = np.nanquantile(np.where(until_peak & ~held, value, np.nan), 0.25, axis=1)
    released = (np.abs((level - falls) / g - 1) < CONTACT.about_g) & (last + 1 >= CONTACT.quiet_samples)
    released &= CONTACT.certain * noise_sd(recordings) < g / 2
    if not released.any():
        return recordings
    # Letting go takes a while.
    first = np.where(released, last + 1 + np.ceil(CONTACT.letting_go * (peak - last)).astype(int), 0)
    return from_sample(recordings, first)


def zero_velocity(slowing: ImpactTraces, v: Rows, x: Rows, pushed: Mask) -> Stop:
    """Zero velocity by the cubic that has the velocities and decelerations of the samples on either side.

    A mass that a strong damper stops comes back so slowly that errors of a thousandth of the velocity at
    contact may leave it above zero for good. What comes after the force is no motion on the tissue.

    Args:
        slowing: decelerations that change the velocity, m/s².
        v: [impact, sample], m/s.
        x: [impact, sample], m.
        pushed: [impact, sample], where the tissue still pushes or will again.
    """
    sample_number, dt = slowing.sample_numbers, slowing.dt
    last = pushed.sum(axis=1) - 1
    passed = (v <= 0) & pushed
    index = first_where(passed, last)
    left = (last < slowing.n_samples - 1) & (at(v, last) < WINDOW.stopped * slowing.velocity)
    reached = passed.any(axis=1)
    before = np.maximum(index - 1, 0)
    v0, v1 = at(v, before), at(v, index)
    apart = at(sample_number, index) - at(sample_number, before)
    step = apart * dt
    m0, m1 = (-at(slowing.value, sample) * step for sample in (before, index))
    # v(s) = v0 + m0 s + p s² + q s³ over the interval, s from 0 to 1.
    p, q = 3 * (v1 - v0) - 2 * m0 - m1, m0 + m1 - 2 * (v1 - v0)
    s = v0 / np.where(v0 > v1, v0 - v1, 1)
    for _ in range(4):
        slope = m0 + 2 * p * s + 3 * q * s**2
        change = (v0 + m0 * s + p * s**2 + q * s**3) / np.where(slope < 0, slope, -1)
        s = np.clip(s - np.where(slope < 0, change, 0), 0, 1)
    s = np.where(reached & (index > 0), s, index - before)
    travelled = (v0 * s + m0 * s**2 / 2 + p * s**3 / 3 + q * s**4 / 4) * step
    x_stop = np.where(reached, at(x, before) + travelled, at(x, last))
    return Stop(index, (at(sample_number, before) + s * apart) * dt, x_stop, reached | left)


def slowest(displacements: ImpactTraces, v: Rows) -> Stop:
    """Zero velocity, or, where it isn't reached, the first place where the motion is slowest.

    Args:
        displacements: from the first sample in contact on, m.
        v: [impact, sample], m/s.
    """
    x, inside, last = displacements.value, displacements.inside, displacements.n_samples - 1
    slow = v < WINDOW.slow * displacements.velocity[:, None]
    passed = (v <= 0) & inside
    reached = passed.any(axis=1)
    slower = np.pad(v[:, 1:] >= v[:, :-1], ((0, 0), (0, 1))) & slow & inside
    index = np.where(reached, first_where(passed, last), first_where(slower, last))
    before = np.maximum(index - 1, 0)
    v0, v1 = at(v, before), at(v, index)
    s = np.where(reached & (v0 > v1), v0 / np.where(v0 > v1, v0 - v1, 1), index - before)
    s = np.clip(s, 0, 1)
    x_stop = at(x, before) + s * (at(x, index) - at(x, before))
    return Stop(index, (before + s) * displacements.dt, x_stop, reached)


def _integrated(
    recordings: ImpactTraces,
    recorder: LowPassFilter | None,
    options: SignalOptions,
    rule: Rule,
    phase: Phase = BETWEEN,
) -> tuple[Displacements, Mask]:
    """Of recorded decelerations; and which of them tell where in a sampling interval contact was."""
    onset = find_onset(recordings, options, recorder)
    quiet = onset.quiet
    recorded = from_sample(recordings, onset.first)
    recorded = replace(recorded, value=recorded.value - quiet.offset[:, None])
    bracket = onset.least, onset.most
    part = replace(recorded, value=beyond_limit(recorded, bracket))
    d, inside, dt = part.value, part.inside, part.dt
    slowing = replace(part, value=d - part.gravity[:, None])
    first = cumulative(slowing, rule)
    second = cumulative(replace(part, value=first), rule)
    bracketed = (onset.most > onset.least) & (onset.most < 1.5 * dt) & ~onset.blurred & ~part.uneven
    start = find_start(part, (first, second), bracket, np.where(bracketed, dt, 0.0), phase.fraction)
    v = start.v[:, None] - first
    x = start.x[:, None] + start.v[:, None] * part.time_s - second
    # The tissue pushes up to the last sample clear of the noise; one clear of great noise that has lifted.
    clear = (d > CONTACT.certain * quiet.noise_sd[:, None]) & inside
    last = np.where(clear.any(axis=1), last_where(clear), clear.shape[1])
    pushed = inside & (samples_before(clear, last + 1) | onset.blurred[:, None])
    stop = zero_velocity(slowing, v, x, pushed)
    flags = {
        Coded.stated("no-zero-velocity.end"): ~stop.reached,
        Coded.stated("contact-doubtful"): onset.doubtful,
        NO_CONTACT: ~quiet.there & (onset.first >= CONTACT.quiet_samples),
    }
    notes = {Coded.stated("no-quiet-part"): ~quiet.there, Coded.stated("uneven-times"): part.uneven}
    parts: Any = {"contact": start, "stop": stop, "quiet": quiet, "before": Before.of(recordings, onset)}
    signal = Displacements(**vars(recorded), x=x, v=v, **parts).over_window(options, flags, notes)
    # Beyond the sensor's limit a trace is what a spring and damper makes of it: it tells nothing of contact.
    bracketed &= ~part.limited
    # Nor does one that begins with its greatest force, of heavily damped tissue: what falls from there on
    # falls the same way whenever it began, and least squares have too small an error.
    bracketed &= d[:, 0] < CONTACT.most_jump * part.filled(0.0).max(axis=1)
    return signal, bracketed


def _recorded(recordings: ImpactTraces, options: SignalOptions) -> Displacements:
    """Of recorded displacements."""
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
    velocity = np.where(np.isfinite(part.velocity), part.velocity, v[:, 0])
    x = part.value - at_contact[:, None]
    stop = slowest(replace(part, value=x, velocity=velocity), clear)
    greatest = recordings.filled(-np.inf).max(axis=1)
    below = (greatest <= 0) & (options.contact != "time-zero")
    flags = {BELOW_ZERO: below, Coded.stated("no-zero-velocity.least"): ~stop.reached & ~below}
    sd = np.where(options.contact == "time-zero", 0, noise / np.maximum(velocity, 1e-12))
    zero, none, rows = np.zeros_like(sd), np.zeros(len(sd), int), np.zeros((len(sd), BEFORE))
    known = (since_contact, sd)
    slowing = replace(part, value=d, velocity=velocity, clipped=np.zeros_like(x))
    motion = Displacements(
        **vars(slowing),
        x=x,
        v=v,
        contact=Start(*known, *known, none > 0, zero, *known, zero, x[:, 0], v[:, 0]),
        stop=stop,
        quiet=QuietPart(none > 0, none, at_contact, noise),
        before=Before(rows, rows, none, none, zero, none > 0),
    )
    return motion.over_window(options, flags, {})


def _end_to_end(*parts: Any) -> Any:
    """Lists, columns, or rows of which shorter ones are filled up with 0."""
    if isinstance(parts[0], list):
        return [row for part in parts for row in part]
    if parts[0].ndim == 2:
        width = max(part.shape[1] for part in parts)
        parts = tuple(np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in parts)
    return np.concatenate(parts)


def _joined(parts: Sequence[Displacements], join: Callable[..., Any] = _end_to_end) -> Displacements:
    """What ``join`` makes of the lists and arrays of all parts, and the phase of the first."""

    def joined(*items: Any) -> Any:
        return type(items[0])(*map(joined, *items)) if isinstance(items[0], tuple) else join(*items)

    names = [one.name for one in fields(Displacements) if one.name != "phase"]
    return replace(parts[0], **{name: joined(*(getattr(part, name) for part in parts)) for name in names})
