"""What a fit says of its recordings: flags, velocity, limits, unused channels, and peaks that it misses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.stats import norm

from bayestissue.base.declarations import general
from bayestissue.base.errors import Coded, codes_of
from bayestissue.base.impact_arrays import MaskPerImpact, PerImpact
from bayestissue.base.outline import first_of
from bayestissue.base.remedies import entries, sentence
from bayestissue.inference.checking.findings import Finding
from bayestissue.inference.checking.model_form import NAMED
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.recordings.dataset.dataset_file import STANDARD_GRAVITY, ChannelSettings

if TYPE_CHECKING:
    from bayestissue.recordings.dataset import Dataset

# So many sound impacts at most have a sample that noise takes beyond the limit: of a thousand, one dataset in
# a hundred.
_BY_CHANCE = 1e-5
# Of the peak: a lesser miss is not worth a word.
_LEAST = 0.01


def flagged_recordings(impacts: Sequence[str], flags: Sequence[Sequence[Coded]]) -> dict[str, Any]:
    """The entry ``recordings`` of ``diagnostics.json``, of those that are flagged; empty without any.

    Args:
        impacts: their names.
        flags: of each.

    Returns:
        ``flagged``, the flags of each impact that has some, and their ``codes``; ``of`` how many.
    """
    named = {impact: list(of_one) for impact, of_one in zip(impacts, flags, strict=True) if of_one}
    if not named:
        return {}
    counts = Counter(flag for of_one in named.values() for flag in of_one)
    codes = codes_of(counts)
    words = sentence(
        "flagged-recordings.words",
        commonest=", ".join(f"{flag} ({count})" for flag, count in counts.most_common(3)),
        their="Its" if len(named) == 1 else "Their",
        **_counted(list(named), len(impacts)),
    )
    return Finding("flagged-recordings", True, words).record(
        flagged=named, codes=[code for code in entries() if code in codes], of=len(impacts)
    )


def contradicted_velocity(flags: Sequence[Sequence[Coded]], chain: Mapping[str, Any]) -> dict[str, Any]:
    """The entry ``velocity``: recordings as of another velocity at contact than was stated.

    Empty without any, and where the measuring chain's own test, ``chain``, says it.
    """
    count = sum("velocity-contradicted" in codes_of(of_one) for of_one in flags)
    if not count or chain.get("passed") is False:
        return {}
    words = sentence("velocity-contradicted.words", count=count, of=len(flags))
    return Finding("velocity-contradicted", False, words, sentence("velocity-contradicted.first")).record()


def clipped_recordings(impacts: Sequence[str], clipped: Sequence[bool]) -> dict[str, Any]:
    """The entry ``clipped``, of recordings with samples at the sensor's limit; empty where none is.

    Args:
        impacts: their names.
        clipped: whether the part of each that the fit is of holds such samples.
    """
    named = [impact for impact, is_clipped in zip(impacts, clipped, strict=True) if is_clipped]
    if not named:
        return {}
    words = sentence("clipped.words", **_counted(named, len(impacts)))
    return Finding("clipped", True, words).record(impacts=named, of=len(impacts))


def unused_channels(channels: Sequence[ChannelSettings], why: str) -> dict[str, Any]:
    """The entry ``channels`` of a fit that is not of the further channels.

    Args:
        channels: the further ones.
        why: they are not used; what warns of a channel is said in the first line too.
    """
    named = first_of([f"{channel.name} ({channel.quantity})" for channel in channels], NAMED)
    # What two channels contradict each other in is said first; that a model has no place for one is not.
    first = isinstance(why, Coded) * sentence("channel-unused.first", channel=channels[0].name, why=why)
    return Finding(
        "channel-unused", True, sentence("channel-unused.words", named=named, why=why), first
    ).record()


def _counted(named: list[str], total: int) -> dict[str, object]:
    """The words of those that are named among all."""
    are = "is" if len(named) == 1 else "are"
    return {"of": total, "count": len(named), "are": are, "named": first_of(named, NAMED)}


def missed_peaks(
    dataset: Dataset, prepared: Prepared, low: PerImpact, high: PerImpact, jerk: PerImpact
) -> MaskPerImpact:
    """Where the greatest sample is farther from the interval of peak_deceleration than the recorder takes it.

    Of the right model it is the peak plus the noise of one of n samples, times the recorder's gain. The
    greatest of n independent normals is above z with a probability of at most n (1 - Phi(z)), which z makes
    one in 100,000. The noise is that of the recording, from its third differences, not the fitted one: what a
    wrong law leaves over counts as noise in the fit, and widens the interval. Below the interval the peak may
    lie between two samples, and after the last one. Behind a low-pass or at the sensor's limit nothing is
    said.

    Args:
        dataset: the recordings, of an impactor that moves freely.
        prepared: the fit of their decelerations.
        low: end of the 90 % interval of peak_deceleration [standard gravity].
        high: its other end.
        jerk: the greatest that is credible [m/s^3]; infinite where it is not known.
    """
    if prepared.model.kind != "impact" or dataset.recorder is not None:
        return np.zeros(len(low), bool)
    signal, chain = prepared.signal, dataset.uncertainty
    recorded = np.exp(np.asarray(prepared.data.log_peak))
    zero_sd = signal.quiet.zero_sd(chain.offset_sd)
    sd = np.sqrt(signal.quiet.noise_sd**2 + (chain.relative_gain_sd * recorded) ** 2 + zero_sd**2)
    room = norm.isf(_BY_CHANCE / signal.n_samples) * sd + _LEAST * recorded
    within = np.argmax(np.abs(signal.deceleration), axis=1) < signal.n_samples - 1
    above = recorded > STANDARD_GRAVITY * high + room
    below = within & (recorded < STANDARD_GRAVITY * low - room - jerk * signal.dt)
    return (above | below) & ~signal.limited


def judge_peaks(dataset: Dataset, prepared: Prepared, summary: pd.DataFrame) -> dict[str, Any]:
    """The entry ``recorded_peak`` of ``diagnostics.json``, empty where no impact's peak is missed.

    Args:
        dataset: the recordings.
        prepared: the fit.
        summary: of its posterior; without peak_deceleration in it nothing is asked.

    Returns:
        ``impacts``, those whose peak is missed; ``of`` how many; ``words``.
    """
    names = prepared.impacts["impact"].astype(str)
    low, high, jerk = (
        summary[summary["variable"] == name].set_index("label")[end].reindex(names).to_numpy(float)
        for name, end in (
            ("peak_deceleration", "eti90_low"),
            ("peak_deceleration", "eti90_high"),
            ("peak_jerk", "eti90_high"),
        )
    )
    missed = missed_peaks(dataset, prepared, low, high, np.where(np.isnan(jerk), np.inf, jerk))
    if not missed.any():
        return {}
    first, named = int(np.argmax(missed)), names[missed].tolist()
    counts = {"count": len(named), "of": len(names)}
    words = sentence(
        "peak-missed.missed",
        named=first_of(named, NAMED),
        impact=names[first],
        recorded=general(np.exp(float(prepared.data.log_peak[first])) / STANDARD_GRAVITY),
        low=general(low[first]),
        high=general(high[first]),
        remedy=sentence(
            "peak-missed.with_discrepancy" if prepared.model.discrepancy else "peak-missed.without"
        ),
        **counts,
    )
    in_first_line = sentence("peak-missed.first", **counts)
    finding = Finding("peak-missed", passed=False, words=words, first=in_first_line, rows=named)
    return finding.record(impacts=named, of=len(names))
