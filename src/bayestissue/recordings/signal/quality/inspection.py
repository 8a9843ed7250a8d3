"""Every detector over every impact, with what each finding does to K and C and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from bayestissue.base.errors import Coded, by_impact
from bayestissue.base.remedies import flags
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.signal.displacement import displacements, motion_of
from bayestissue.recordings.signal.padded_traces import Column, Index, Mask, samples_before
from bayestissue.recordings.signal.quality import beginning, force_laws, samples, velocity
from bayestissue.recordings.signal.quality.samples import PulseAndRests
from bayestissue.recordings.signal.signal_settings import PULSE, SignalOptions

# By the key of `bayestissue.base.remedies.flags`: of each impact what was found in words, empty where nothing
# was.
Findings = Mapping[str, list[str]]


def inspect(dataset: Dataset, options: SignalOptions | None = None) -> Findings:
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
        What some impact has.
    """
    options = options or SignalOptions()
    longest = max((len(trace.value) for trace in dataset.traces), default=1)
    size, joined = max(1, min(PULSE.most, PULSE.block // longest)), dict[str, list[str]]()
    implied: list[velocity.Implied] = []
    for begin in range(0, len(dataset.traces), size):
        rows = slice(begin, begin + size)
        part = dataset.select(rows)
        # A recording that is no impact at all may divide by nothing: what comes of that finds nothing.
        with np.errstate(all="ignore"):
            for key, said in _inspected(part, options, implied):
                joined.setdefault(key, []).extend(said)
    if implied:
        joined["velocity-contradicted"] = said = _velocities(dataset, implied)
        # Gravity is along the motion of all impacts or of none: what one trace asks of it is its velocity's.
        for key in {"gravity.declared", "gravity.undeclared"} & joined.keys():
            joined[key] = ["" if words else remark for words, remark in zip(said, joined[key], strict=True)]
    return {key: said for key, said in joined.items() if any(said)}


def _velocities(dataset: Dataset, implied: Sequence[velocity.Implied]) -> list[str]:
    """What all recordings together say of the velocities, of each impact."""
    impacts = dataset.impacts
    conditions = impacts["trial"].astype(str) if "trial" in impacts else np.zeros(len(impacts))
    falls = dataset.gravity > 0 or any(str(name).startswith("drop_height") for name in impacts)
    whole = velocity.Implied(*map(np.concatenate, zip(*implied, strict=True)))
    kinds, fractions = velocity.contradictions(whole, pd.factorize(conditions)[0], _levels(impacts))
    said = zip(kinds, fractions, impacts.to_dict("records"), strict=True)
    return [velocity.in_words(*of_impact, falls=falls) for of_impact in said]


def _levels(impacts: pd.DataFrame) -> list[np.ndarray]:
    """Numbers of the levels of each column that may say what was hit: words that several impacts share."""
    others = impacts.drop(columns=["impact", "trial", "trace"], errors="ignore")
    words = others.select_dtypes(exclude="number")
    numbers = (pd.factorize(words[name].astype(str))[0] for name in words)
    return [codes for codes in numbers if 0 < codes.max(initial=0) < len(codes) - 1]


def raised(findings: Findings, count: int, *, notes: bool = False) -> list[list[Coded]]:
    """The flags of each of ``count`` impacts, or its notes."""
    of_kind = {key: said for key, said in findings.items() if flags()[key].note == notes}
    return by_impact({Coded.stated(key): said for key, said in of_kind.items()}, count)


def _found(key: str, raised: Mask, values: np.ndarray) -> tuple[str, list[str]]:
    """Of each impact in which it is raised what was found, with its number."""
    pairs = zip(raised, values.tolist(), strict=True)
    return key, [flags()[key].found.format(value) if up else "" for up, value in pairs]


def _inspected(
    part: Dataset, options: SignalOptions, implied: list[velocity.Implied]
) -> Iterator[tuple[str, list[str]]]:
    recordings = motion_of(part.traces, part.quantity)
    recorded = PulseAndRests.from_recordings(recordings)
    limited = recordings.at_limit.sum(axis=1)
    yield _found("clipped.limit", limited > 0, limited)
    known = options.contact == "time-zero"
    start = np.where(known, 0, samples.starts_off_zero(recorded))
    findings = [*_single_samples(recorded, limited)]
    if part.quantity == "displacement":
        # A displacement that passes 0 on its way shows its contact.
        early = samples_before(recorded.value, recorded.top + 1)
        deep = (start > PULSE.above) & (np.where(early, recorded.value, np.inf).min(axis=1) > 0)
        yield from (*findings, _found("starts-deep.first", deep, start))
        return
    signal = displacements(part, options.model_copy(update={"window": "rebound"}))
    findings += _at_rest(recorded, signal.time_to_peak, part.gravity)
    above, longest = start > PULSE.above, np.zeros_like(start)
    if part.recorder is None:
        # An impact's force may jump at contact; behind a low-pass it can't.
        candidate = (start > 0) & (limited == 0)
        above, longest = beginning.beginning(recorded, signal, candidate, part.uncertainty)
    findings.append(_found("starts-above-zero", above, start))
    findings.append(_found("starts-below-zero", start < -PULSE.above, start))
    yield _found("contact-earlier", longest > 0, 1e3 * longest)
    yield from (finding for finding in findings if part.recorder is None or finding[0] != "slow-low-pass")
    # What a declared low-pass makes of a law is none.
    if part.recorder is not None:
        return
    # A law is asked of whole recordings.
    used = signal.inside & (limited == 0)[:, None]
    other_gravity = force_laws.another_gravity(signal, used, recorded)
    key = "gravity.declared" if part.gravity else "gravity.undeclared"
    yield _found(key, other_gravity, force_laws.gravity_tried(signal))
    named = np.array([[bool(words) for words in said] for _, said in findings]).any(axis=0)
    of_part = velocity.implied(signal, recorded, part.uncertainty)
    # What has another name is no velocity.
    usable = of_part.usable & ~named
    implied.append(of_part._replace(usable=usable, explained=of_part.explained & usable & ~other_gravity))
    unnamed = used & ~(named | other_gravity)[:, None]
    none = force_laws.no_law(signal, unnamed, recorded)
    yield _found("no-law", none, none)


def _single_samples(recorded: PulseAndRests, limited: Index) -> Iterator[tuple[str, list[str]]]:
    # A plateau repeats its value, and ends at once.
    sound = limited == 0
    spike, repeated, levels = samples.spikes(recorded), samples.standing(recorded), samples.levels(recorded)
    yield _found("spike", (spike >= 0) & sound, spike + 1)
    yield _found("repeated-samples", (repeated > 0) & sound, repeated)
    yield _found("coarse-steps", np.isfinite(levels), levels)


def _at_rest(recorded: PulseAndRests, to_peak: Column, along: float) -> Iterator[tuple[str, list[str]]]:
    uneven = samples.uneven(recorded, to_peak)
    frequency, moved = samples.hum(recorded, uneven), samples.moved_zero(recorded, along)
    slow = samples.slow_noise(recorded, to_peak)
    yield _found("hum", np.isfinite(frequency), frequency)
    yield _found("drift.rest", uneven & np.isnan(frequency), moved)
    yield _found("zero-moved", (moved != 0) & ~uneven, moved)
    yield _found("slow-low-pass", np.isfinite(slow) & ~uneven, slow)
