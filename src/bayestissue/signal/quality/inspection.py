"""Every detector over every impact, with what each finding does to K and C and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from bayestissue.dataset.chain import Recorder, Uncertainty
from bayestissue.errors import Coded
from bayestissue.remedies import entries
from bayestissue.signal.displacement import Displacements, RecordedImpacts, displacements
from bayestissue.signal.options import SignalOptions
from bayestissue.signal.quality import beginning, law, samples
from bayestissue.signal.quality.recorded import Recorded
from bayestissue.signal.traces import Column, Mask, Trace, stack

# So many samples, and impacts, at a time: their laws' terms then take some hundred megabytes at most.
_BLOCK, _MOST = 200_000, 256
# Of the peak: a first sample above it is an offset or late where nothing else can be asked.
_ABOVE = 0.04


class Kind(NamedTuple):
    """One kind of finding.

    Attributes:
        flag: what it is called.
        expected: instead of it.
        words: what was found, with braces for its number.
        note: whether it is only noted, not flagged.
    """

    flag: Coded
    expected: str
    words: str
    note: bool = False

    @property
    def advice(self) -> str:
        """What it does to K and C, and what to do."""
        return entries()[self.flag.code].advice

    def where(self, raised: Mask, values: np.ndarray) -> Finding:
        """The finding in those impacts in which it is raised, with the number of each."""
        pairs = zip(raised, values.tolist(), strict=True)
        return Finding(self, [self.words.format(value) if up else "" for up, value in pairs])


@dataclass(frozen=True)
class Finding:
    """What one detector found.

    Attributes:
        kind: what it is.
        said: per impact what was found in words; empty where nothing was.
    """

    kind: Kind
    said: list[str]


SPIKE = Kind(
    Coded("a spike of one to three samples", "spike"),
    "samples that follow from their neighbours",
    "one at sample {}",
)
STANDING = Kind(
    Coded("samples that repeat the one before", "repeated-samples"),
    "a new value in each sample while the signal moves",
    "{} such samples",
)
COARSE = Kind(
    Coded("steps of the recorder too coarse for the peak", "coarse-steps"),
    "20 or more steps of the recorder in the peak",
    "{:.3g} steps",
)
HUM = Kind(
    Coded("hum while nothing is touched", "hum"),
    "a level signal before and after contact",
    "a wave of {:.0f} Hz",
)
DRIFT = Kind(
    Coded("drift while nothing is touched", "drift"),
    "a level signal before and after contact",
    "a signal that is not level",
)
MOVED = Kind(
    Coded("the zero after contact is another than before", "zero-moved"),
    "the same mean before contact and after it",
    "a difference of {:.1%} of the peak",
)
ABOVE = Kind(
    Coded("begins above zero: after contact, or with an offset", "starts-above-zero"),
    "a recording that begins before contact",
    "{:.1%} of the peak at the first sample",
)
EARLIER = Kind(
    Coded("contact may have come before the first sample", "contact-earlier"),
    "a recording that begins before contact",
    "up to {:.2g} ms before",
    note=True,
)
BELOW = Kind(
    Coded("begins below zero: an offset", "starts-below-zero"),
    "a recording that begins at zero, or with a quiet part that tells the offset",
    "{:.1%} of the peak at the first sample",
)
SLOW = Kind(
    Coded("noise slower than the impact: a low-pass", "slow-low-pass"),
    "noise up to far higher frequencies than those of the impact",
    "noise up to {:.0f} Hz",
)
SATURATED = Kind(
    Coded("flatter at the top than any tissue makes it: saturated or cut off", "saturated"),
    "a force that some spring and damper could make",
    "what a limit of {:.2g} times the peak makes",
)
NO_LAW = Kind(
    Coded("no force of depth and velocity gives this trace", "no-law"),
    "a deceleration that follows from depth and velocity, whatever the tissue",
    "structure beyond noise in what every law leaves over",
)
FALLS = Kind(
    Coded("looks like gravity along the motion, which is not declared", "gravity"),
    'signal.gravity = "drop" in dataset.toml where the impactor falls straight down',
    "a trace that gravity of {:.3g} m/s² explains far better",
)
FALLS_NOT = Kind(
    Coded("looks like no gravity along the motion, though it is declared", "gravity"),
    'signal.gravity = "none" in dataset.toml where the impactor moves across gravity',
    "a trace that gravity of {:.3g} m/s² explains far better",
)
DEEP = Kind(
    Coded(
        "begins above zero: contact came before the recording, or the sensor has another zero", "starts-deep"
    ),
    "a displacement that begins at 0, where contact is",
    "{:.1%} of the peak at the first sample",
)


@dataclass(frozen=True)
class _Part:
    quantity: Literal["deceleration", "acceleration", "displacement"]
    impacts: pd.DataFrame
    traces: Sequence[Trace]
    recorder: Recorder | None
    gravity: float
    uncertainty: Uncertainty


def inspect(dataset: RecordedImpacts, options: SignalOptions | None = None) -> list[Finding]:
    """Look at every recording of a dataset.

    Each detector is a test with a false alarm rate of 0.001 (0.003 where laws are fitted) a sound recording,
    all samples and values that it tries taken together, and finds only what is large enough to change K or C
    by some per cent. A recording that begins above zero may begin at contact: it is found where an impact
    that began earlier, or an offset, explains it far better (1 % of sound ones), and is noted where an
    earlier one explains it as well. What only says that no tissue makes such a trace is asked of
    impacts that no other detector names.

    Args:
        dataset: the recordings.
        options: how displacements are made from them. With contact = "time-zero" a recording may begin in
            contact.

    Where a low-pass is declared, noise that it may have slowed and laws that it changes are not asked.

    Returns:
        One finding for each kind that some impact has.
    """
    options = options or SignalOptions()
    longest = max((len(trace.value) for trace in dataset.traces), default=1)
    size, joined = max(1, min(_MOST, _BLOCK // longest)), dict[Kind, list[str]]()
    for begin in range(0, len(dataset.traces), size):
        rows = slice(begin, begin + size)
        impacts, traces = dataset.impacts.iloc[rows], dataset.traces[rows]
        chain = dataset.recorder, dataset.gravity, dataset.uncertainty
        part = _Part(dataset.quantity, impacts, traces, *chain)
        # A recording that is no impact at all may divide by nothing: what comes of that finds nothing.
        with np.errstate(all="ignore"):
            for finding in _inspected(part, options):
                joined.setdefault(finding.kind, []).extend(finding.said)
    return [Finding(kind, values) for kind, values in joined.items() if any(values)]


def raised(findings: Sequence[Finding], count: int, *, notes: bool = False) -> list[list[Coded]]:
    """The flags of each of ``count`` impacts, or its notes."""
    of_kind = [finding for finding in findings if finding.kind.note == notes]
    return [[finding.kind.flag for finding in of_kind if finding.said[row]] for row in range(count)]


def _inspected(part: _Part, options: SignalOptions) -> Iterator[Finding]:
    sign = -1.0 if part.quantity == "acceleration" else 1.0
    recordings = stack(part.traces)
    recorded = Recorded.from_recordings(replace(recordings, value=sign * recordings.value))
    known = options.contact == "time-zero"
    start = np.where(known, 0, samples.starts_off_zero(recorded))
    findings = [*_single_samples(recorded)]
    if part.quantity == "displacement":
        # A displacement that passes 0 on its way shows its contact.
        early = np.arange(recorded.value.shape[1]) <= recorded.top[:, None]
        deep = (start > _ABOVE) & (np.where(early, recorded.value, np.inf).min(axis=1) > 0)
        yield from (*findings, DEEP.where(deep, start))
        return
    whole = {"window": "rebound", "filter": "none", "equilibrium": "rest"}
    signal = displacements(part, options.model_copy(update=whole))
    findings += _at_rest(recorded, signal.time_to_peak, part.gravity)
    above, longest = start > _ABOVE, np.zeros_like(start)
    if part.recorder is None:
        # An impact's force may jump at contact; behind a low-pass it can't.
        above, longest = beginning.beginning(recorded, signal, start > 0, part.uncertainty)
    findings += [ABOVE.where(above, start), BELOW.where(start < -_ABOVE, start)]
    yield EARLIER.where(longest > 0, 1e3 * longest)
    yield from (finding for finding in findings if part.recorder is None or finding.kind is not SLOW)
    # What a declared low-pass makes of a law is none.
    if part.recorder is not None:
        return
    used = np.arange(signal.x.shape[1]) < signal.n_samples[:, None]
    other_gravity = law.another_gravity(signal, used, recorded.sd, recorded.freedom)
    yield (FALLS_NOT if part.gravity else FALLS).where(other_gravity, law.gravity_tried(signal))
    named = np.array([[bool(words) for words in finding.said] for finding in findings]).any(axis=0)
    yield from _laws(recorded, signal, used & ~(named | other_gravity)[:, None])


def _single_samples(recorded: Recorded) -> Iterator[Finding]:
    spike, repeated, levels = samples.spikes(recorded), samples.standing(recorded), samples.levels(recorded)
    yield SPIKE.where(spike >= 0, spike + 1)
    yield STANDING.where(repeated > 0, repeated)
    yield COARSE.where(np.isfinite(levels), levels)


def _at_rest(recorded: Recorded, to_peak: Column, along: float) -> Iterator[Finding]:
    uneven = samples.uneven(recorded, to_peak)
    frequency, moved = samples.hum(recorded, uneven), samples.moved_zero(recorded, along)
    slow = samples.slow_noise(recorded, to_peak)
    yield HUM.where(np.isfinite(frequency), frequency)
    yield DRIFT.where(uneven & np.isnan(frequency), moved)
    yield MOVED.where((moved != 0) & ~uneven, moved)
    yield SLOW.where(np.isfinite(slow) & ~uneven, slow)


def _laws(recorded: Recorded, signal: Displacements, used: Mask) -> Iterator[Finding]:
    start = law.Start(signal.dt, signal.x[:, 0], signal.v[:, 0], signal.gravity)
    limit = law.saturation(signal.deceleration, used, start, recorded.sd)
    flat = limit > 0
    none = law.no_law(signal.deceleration, used, start, recorded.sd, recorded.freedom, recorded.peak)
    yield SATURATED.where(flat, limit)
    yield NO_LAW.where((limit == 0) | none & ~flat, limit)
