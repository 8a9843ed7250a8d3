"""Every detector over every impact, with what each finding does to K and C and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd

from bayestissue.dataset.model import Recorder, Uncertainty
from bayestissue.errors import Coded
from bayestissue.signal.displacement import Displacements, RecordedImpacts, displacements
from bayestissue.signal.options import SignalOptions
from bayestissue.signal.quality import beginning, gravity, law, quiet, samples
from bayestissue.signal.quality.kinds import (
    ABOVE,
    BELOW,
    COARSE,
    DEEP,
    DRIFT,
    EARLIER,
    FALLS,
    FALLS_NOT,
    HUM,
    MOVED,
    NO_LAW,
    SATURATED,
    SLOW,
    SPIKE,
    STANDING,
    Kind,
)
from bayestissue.signal.quality.recorded import Recorded
from bayestissue.signal.traces import Column, Mask, Trace, stack

# So many samples, and impacts, at a time: their laws' terms then take some hundred megabytes at most.
_BLOCK, _MOST = 200_000, 256
# Of the peak: a first sample above it is an offset or late where nothing else can be asked.
_ABOVE = 0.04


@dataclass(frozen=True)
class Finding:
    """What one detector found.

    Attributes:
        kind: what it is.
        said: per impact what was found in words; empty where nothing was.
    """

    kind: Kind
    said: list[str]


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
            for kind, values in _inspected(part, options):
                joined.setdefault(kind, []).extend(values)
    return [Finding(kind, values) for kind, values in joined.items() if any(values)]


def raised(findings: Sequence[Finding], count: int, *, notes: bool = False) -> list[list[Coded]]:
    """The flags of each of ``count`` impacts, or its notes."""
    of_kind = [finding for finding in findings if finding.kind.note == notes]
    return [[finding.kind.flag for finding in of_kind if finding.said[row]] for row in range(count)]


def _inspected(part: _Part, options: SignalOptions) -> Iterator[tuple[Kind, list[str]]]:
    sign = -1.0 if part.quantity == "acceleration" else 1.0
    recordings = stack(part.traces)
    recorded = Recorded.from_recordings(replace(recordings, value=sign * recordings.value))
    known = options.contact == "time-zero"
    start = np.where(known, 0, quiet.starts_off_zero(recorded))
    if part.quantity == "displacement":
        yield from _single_samples(recorded)
        # A displacement that passes 0 on its way shows its contact.
        early = np.arange(recorded.value.shape[1]) <= recorded.top[:, None]
        deep = (start > _ABOVE) & (np.where(early, recorded.value, np.inf).min(axis=1) > 0)
        yield DEEP, _words(deep, "{:.1%} of the peak at the first sample", start)
        return
    whole = {"window": "rebound", "filter": "none", "equilibrium": "rest"}
    signal = displacements(part, options.model_copy(update=whole))
    findings = [*_single_samples(recorded), *_at_rest(recorded, signal.time_to_peak, part.gravity)]
    above, longest = start > _ABOVE, np.zeros_like(start)
    if part.recorder is None:
        # An impact's force may jump at contact; behind a low-pass it can't.
        above, longest = beginning.beginning(recorded, signal, start > 0, part.uncertainty)
    first = "{:.1%} of the peak at the first sample"
    findings.append((ABOVE, _words(above, first, start)))
    findings.append((BELOW, _words(start < -_ABOVE, first, start)))
    yield EARLIER, _words(longest > 0, "up to {:.2g} ms before", 1e3 * longest)
    yield from ((kind, said) for kind, said in findings if part.recorder is None or kind is not SLOW)
    # What a declared low-pass makes of a law is none.
    if part.recorder is not None:
        return
    used = np.arange(signal.x.shape[1]) < signal.n_samples[:, None]
    other_gravity = gravity.another(signal, used, recorded.sd, recorded.freedom)
    words = "a trace that gravity of {:.3g} m/s² explains far better"
    yield FALLS_NOT if part.gravity else FALLS, _words(other_gravity, words, gravity.tried(signal))
    named = (
        np.array([[bool(value) for value in values] for _, values in findings]).any(axis=0) | other_gravity
    )
    yield from _laws(recorded, signal, used & ~named[:, None])


def _single_samples(recorded: Recorded) -> Iterator[tuple[Kind, list[str]]]:
    sample, repeated, levels = samples.spikes(recorded), samples.standing(recorded), samples.levels(recorded)
    yield SPIKE, _words(sample >= 0, "one at sample {}", sample + 1)
    yield STANDING, _words(repeated > 0, "{} such samples", repeated)
    yield COARSE, _words(np.isfinite(levels), "{:.3g} steps", levels)


def _at_rest(recorded: Recorded, to_peak: Column, along: float) -> Iterator[tuple[Kind, list[str]]]:
    uneven = quiet.uneven(recorded, to_peak)
    frequency, moved = quiet.hum(recorded, uneven), quiet.moved_zero(recorded, along)
    slow = quiet.slow_noise(recorded, to_peak)
    yield HUM, _words(np.isfinite(frequency), "a wave of {:.0f} Hz", frequency)
    yield DRIFT, _words(uneven & np.isnan(frequency), "a signal that is not level", moved)
    yield MOVED, _words((moved != 0) & ~uneven, "a difference of {:.1%} of the peak", moved)
    yield SLOW, _words(np.isfinite(slow) & ~uneven, "noise up to {:.0f} Hz", slow)


def _laws(recorded: Recorded, signal: Displacements, used: Mask) -> Iterator[tuple[Kind, list[str]]]:
    start = law.Start(signal.dt, signal.x[:, 0], signal.v[:, 0], signal.gravity)
    limit = law.saturation(signal.deceleration, used, start, recorded.sd)
    flat = limit > 0
    none = law.no_law(signal.deceleration, used, start, recorded.sd, recorded.freedom, recorded.peak)
    odd = (limit == 0) | none & ~flat
    yield SATURATED, _words(flat, "what a limit of {:.2g} times the peak makes", limit)
    yield NO_LAW, _words(odd, "structure beyond noise in what every law leaves over", limit)


def _words(raised: Mask, words: str, values: np.ndarray) -> list[str]:
    return [words.format(value) if here else "" for here, value in zip(raised, values.tolist(), strict=True)]
