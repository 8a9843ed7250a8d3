"""Further channels of a dataset's impacts: read as the first is, and what can be wrong with them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64

from bayestissue.dataset.checks import OF_SAMPLES, check_recordings
from bayestissue.dataset.impacts import ImpactTable
from bayestissue.dataset.reading import read_files, read_long
from bayestissue.dataset.recordings import Reading, Recordings, Windows, crop, with_limits
from bayestissue.dataset.settings import ChannelSettings, Settings, SignalSettings
from bayestissue.dataset.traces import MIN_SAMPLES
from bayestissue.errors import Problem, all_of


def read_channels(folder: Path, table: ImpactTable, settings: Settings) -> list[Reading]:
    """The recordings of every further channel, on the first one's clock.

    Args:
        folder: the dataset's.
        table: the impacts.
        settings: what ``dataset.toml`` says.

    Raises:
        InputError: a table can't be read, or lacks the channel's column.
    """

    def read(channel: ChannelSettings) -> Reading:
        signal = channel.as_signal(settings.signal)
        if channel.file is None and "trace" in table.table:
            reading = read_files(folder, table.table, table.row, signal, settings.signal)
        else:
            beside = settings.signal if channel.file is None else None
            reading = read_long(folder, table.table["impact"].tolist(), signal, channel.file, beside)
        return on_first_clock(reading, channel)

    return all_of(read, settings.channel)


def on_first_clock(reading: Reading, channel: ChannelSettings) -> Reading:
    """A channel's recordings by the first channel's clock."""
    time = reading.samples.time_s + channel.time_offset_s
    return replace(reading, samples=replace(reading.samples, time_s=time))


def checked_channel(
    channel: ChannelSettings,
    reading: Reading,
    impacts: pd.DataFrame,
    signal: SignalSettings,
    first: Recordings,
) -> Reading:
    """The channel's recordings with all that is wrong with them.

    Samples and clocks as of the first channel, times that do not meet the first channel's, a channel that
    never changes, and a force of the wrong sign.

    Args:
        channel: what ``dataset.toml`` says of it.
        reading: the recordings.
        impacts: the table of impacts.
        signal: the first channel's settings.
        first: the first channel, of impacts with nothing wrong so far.
    """
    samples, problems = crop(reading.samples, Windows.stated(impacts, signal), impacts["impact"].tolist())
    samples = with_limits(samples, channel.quantity, channel.as_signal(signal).limits_si)
    if channel.file is not None:
        # The rate that impacts.csv states is the first channel's.
        impacts = impacts.drop(columns="sampling_rate_hz", errors="ignore")
    recordings = Recordings(samples, impacts, first.quantity, first.uncertainty)
    findings = check_recordings(recordings, OF_SAMPLES)
    return replace(
        reading,
        samples=samples,
        problems=[*reading.problems, *problems, *findings.problems, *_unfit(findings.sound, first)],
    )


def _unfit(recordings: Recordings, first: Recordings) -> Iterator[Problem]:
    """What the first channel says against recordings whose samples and clocks are sound."""
    recordings = recordings.of_impacts(first.name)
    if not len(recordings.samples):
        return
    samples, owner = recordings.samples, recordings.samples.owner
    reference = first.samples.slowing(first.quantity)
    mine = pd.Index(first.name).get_indexer(pd.Index(recordings.name))[owner]
    inside = (samples.time_s >= reference.time_s[reference.begin][mine]) & (
        samples.time_s <= reference.time_s[reference.end - 1][mine]
    )
    recorded = reference.interpolated(samples.time_s, mine)
    count = np.add.reduceat(inside.astype(int), samples.begin)
    apart = count < MIN_SAMPLES
    words = "{} of its samples while the first channel was recorded"
    yield from recordings.where(apart, "channel-unfit.apart", words, count, least=MIN_SAMPLES)

    def centred(values: Float64[np.ndarray, " sample"]) -> Float64[np.ndarray, " sample"]:
        values = np.where(inside, values, 0.0)
        mean = np.add.reduceat(values, samples.begin) / np.maximum(count, 1)
        return np.where(inside, values - mean[owner], 0.0)

    force, compared = centred(samples.value), centred(recorded)
    dead = ~apart & (np.maximum.reduceat(np.abs(force), samples.begin) == 0)
    yield from recordings.where(dead, "constant-signal", "{:g} in every sample", samples.value[samples.begin])
    together = np.add.reduceat(force * compared, samples.begin)
    sizes = [np.sqrt(np.add.reduceat(one**2, samples.begin)) for one in (force, compared)]
    correlation = together / np.maximum(sizes[0] * sizes[1], np.finfo(float).tiny)
    wrong = ~apart & ~dead & (correlation < 0)
    yield from recordings.where(wrong, "channel-unfit.sign", "a correlation of {:.2f}", correlation)
