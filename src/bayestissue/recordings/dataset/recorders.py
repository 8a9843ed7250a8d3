"""Recordings out of files: one long table of all samples, or a recorder's file for each impact.

A file is a table (CSV, Excel, Parquet) or of one of `dataset.formats`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from itertools import pairwise
from math import isnan
from pathlib import Path

import numpy as np

from bayestissue.base.errors import InputError, Problem, refuse
from bayestissue.recordings.dataset.cells import number_in
from bayestissue.recordings.dataset.clock_times import within_a_day
from bayestissue.recordings.dataset.dataset_file import ChannelSettings, Settings, SignalSettings
from bayestissue.recordings.dataset.formats import FORMATS, labview
from bayestissue.recordings.dataset.formats.channel import (
    Channel,
    Contents,
    Format,
    UnfitError,
    unit_in_name,
)
from bayestissue.recordings.dataset.impact_table import ImpactTable
from bayestissue.recordings.dataset.ragged_traces import MIN_SAMPLES
from bayestissue.recordings.dataset.recordings import (
    Recordings,
    in_seconds,
    numbers_in,
    windows_of,
)
from bayestissue.recordings.dataset.sample_tables import TABLE_SUFFIXES, TEXT_SUFFIXES, read_table
from bayestissue.recordings.dataset.source_files import Source, decoded, require_small
from bayestissue.recordings.dataset.units import dimension_of, to_si

LONG_TABLES = ("traces.csv", "traces.csv.gz", "traces.xlsx", "traces.parquet")
_TABLES = (*TABLE_SUFFIXES, *TEXT_SUFFIXES)
SUFFIXES = (*TABLE_SUFFIXES, *FORMATS)
# What says time in the name of a column.
TIME = "(?:time|timestamp|elapsed|zeit|uhrzeit|temps|tiempo|tempo|t)"
_NAMED = re.compile(rf"(?:^|[\W_]){TIME}(?:[\W_\d]|$)", re.IGNORECASE)
# Of a sampling interval: times that differ by less are alike.
_ALIKE = 0.25


def read_recordings(folder: Path, table: ImpactTable, settings: Settings) -> list[Recordings]:
    """The recordings of the first channel, and those of every further one on the first one's clock.

    Args:
        folder: the dataset's.
        table: the impacts.
        settings: what ``dataset.toml`` says.

    Raises:
        InputError: a table can't be read, or lacks a channel's column; there is no table of samples, or more
            than one, or one beside a column ``trace``.
    """
    path = _long_table(folder, in_files="trace" in table.table)
    read = partial(_read_long, path) if path else partial(read_files, folder)
    recordings = [read(table, settings)]
    for channel in settings.channel:
        further = partial(_read_long, folder / channel.file) if channel.file else read
        recordings.append(further(table, settings, channel))
    return recordings


def _long_table(folder: Path, *, in_files: bool) -> Path | None:
    """The one table of all samples; None where each impact has a file, beside which there must be none."""
    names = [name for name in LONG_TABLES if (folder / name).exists()]
    if len(names) + in_files != 1:
        key = "both" if in_files else "several" if names else "no-table"
        there = [*names, "a column trace in impacts.csv"] if in_files else names
        words = {"value": ", ".join(there) or "no table of samples", "tables": ", ".join(LONG_TABLES)}
        raise InputError.stated(f"which-recordings.{key}", (names or LONG_TABLES)[0], **words)
    return folder / names[0] if names else None


def _on_first_clock(recordings: Recordings, channel: ChannelSettings | None) -> Recordings:
    """A channel's recordings by the first channel's clock; those of the first, None, as they are."""
    return replace(recordings, time_s=recordings.time_s + channel.time_offset_s) if channel else recordings


def _read_long(
    path: Path, table: ImpactTable, settings: Settings, channel: ChannelSettings | None = None
) -> Recordings:
    """The recordings in one long table of all samples; arguments as of `read_files`."""
    signal, first = settings.signal_of(channel)
    contents = read_table(
        Source(path, path.name, stated=signal),
        numbers=[signal.time_column, signal.value_column],
        labels=["impact"],
        optional=partial(clocks_beside, signal, first),
    )
    return replace(long_recordings(path.name, contents, table, settings, channel), paths=[path])


def long_recordings(
    file: str, contents: Contents, table: ImpactTable, settings: Settings, channel: ChannelSettings | None
) -> Recordings:
    """The recordings in columns that were read already, sorted by impact.

    Args:
        file: what messages call the table of samples.
        contents: impact, time and value of each sample, in their units.
        table: the impacts that there should be, in order.
        settings: what ``dataset.toml`` says.
        channel: a further one; None of the first.
    """
    contents, signal = at_own_clock(contents, *settings.signal_of(channel), file)
    labels, recorded = contents.labels["impact"], _with_times(contents, signal)
    impacts = table.table["impact"].tolist()
    position = {name: index for index, name in reversed(list(enumerate(impacts)))}
    codes = np.array([position.get(name, -1) for name in labels.names], int)[labels.codes]
    count = np.bincount(codes[codes >= 0], minlength=len(impacts))
    problems = []
    strange = np.flatnonzero(codes < 0)
    for code, index in zip(*np.unique(labels.codes[strange], return_index=True), strict=True):
        name = labels.names[code]
        where = file, contents.rows_of(signal.value_column)[strange[index]], "impact", name or "an empty cell"
        problems.append(Problem.stated("impacts-and-recordings.unknown", *where, impact=name))
    problems += [
        Problem.stated("impacts-and-recordings.missing", file, None, "impact", "no samples", impact=name)
        for index, name in enumerate(impacts)
        # A name that stands there twice has been reported as such.
        if not count[index] and name and position[name] == index
    ]
    of_table = settings, signal, table.table, file, problems
    unsorted = Recordings.from_channel(recorded, count, *of_table)
    order, has = np.argsort(codes, kind="stable")[np.count_nonzero(codes < 0) :], np.flatnonzero(count)
    return _on_first_clock(unsorted.taken(order, has, count[has]).to_their_ends, channel)


def read_files(
    folder: Path, table: ImpactTable, settings: Settings, channel: ChannelSettings | None = None
) -> Recordings:
    """Read one recorder file per impact, as the column ``trace`` names them.

    Args:
        folder: the dataset's.
        table: the impacts, with a column ``trace`` and perhaps ``sampling_rate_hz``.
        settings: what ``dataset.toml`` says.
        channel: a further one; None of the first.
    """
    impacts, rows = table.table, table.row
    problems: list[Problem] = []
    pieces: list[Recordings] = []
    names = impacts["impact"].tolist()
    signal, _ = settings.signal_of(channel)
    rates, windows = numbers_in(impacts, "sampling_rate_hz"), windows_of(impacts, signal)
    taken: dict[Source, list[int]] = {}
    # One that several impacts share is read once: they mostly follow each other.
    whole = lru_cache(maxsize=1)(lambda source, rate: read_one(source, settings, float(rate), channel))
    size = 0
    for index, name in enumerate(impacts["trace"]):
        try:
            source = _inside(folder, name, int(rows[index]))
            (start, stop), (starts, stops) = windows[:, index], windows[:, taken.get(source, [])]
            if ((start < stops) & (starts < stop)).any():
                # An earlier impact has the recording, or a part of this one.
                cropped = np.isfinite(start) or np.isfinite(stop)
                value = f"{source.label}, from {start:.6g} to {stop:.6g} s" if cropped else source.label
                where = "impacts.csv", int(rows[index]), "trace", value
                raise InputError.stated("impacts-and-recordings.shared", *where)
            recording = whole(source, str(rates[index]))
        except InputError as error:
            of_impact = partial(replace, impact=names[index] or None, files_read=len(impacts))
            problems += map(of_impact, error.problems)
            continue
        taken.setdefault(source, []).append(index)
        piece = replace(recording, impacts=impacts, position=np.array([index])).cropped
        problems += piece.problems
        if not piece.problems:
            size += piece.time_s.nbytes + piece.value.nbytes
            require_small(size, "the recordings together")
            pieces.append(piece)
    paths = list(dict.fromkeys(source.path for source in taken))
    joined = Recordings.joined(pieces, settings, signal, impacts, "", problems, (), paths)
    return _on_first_clock(joined, channel)


def read_one(
    source: Source, settings: Settings, rate: float, channel: ChannelSettings | None = None
) -> Recordings:
    """A whole recording, in SI units, of an impact that is not named yet.

    Args:
        source: the file.
        settings: what ``dataset.toml`` says.
        rate: the sampling rate in Hz, where the file has no times.
        channel: a further one; None of the first.

    Raises:
        InputError: the file is missing or damaged, lacks a channel, or has no times.
    """
    signal, first = settings.signal_of(channel)
    recorded = read_recording(source, signal, first)
    time, count = recorded.clock, len(recorded.values)
    if time is None and np.isfinite(rate):
        time = np.arange(count) / rate
    if time is None:
        raise InputError.stated("no-times", source.label, column=signal.time_column, value="no times")
    timed = replace(recorded, clock=time)
    return Recordings.from_channel(timed, [count], settings, signal).to_their_ends


def _inside(folder: Path, name: str, row: int) -> Source:
    if not name:
        raise InputError.stated("which-recordings.none", "impacts.csv", row, "trace", "an empty cell")
    remedy = "Correct the cell in column trace of impacts.csv, or put the file there."
    with suppress(OSError, ValueError, RuntimeError):
        path = (folder / name).resolve()
        if path.is_relative_to(folder.resolve()) and not Path(name).is_absolute():
            return Source.at(path, name, remedy=remedy)
    raise InputError.stated("which-recordings.outside", "impacts.csv", row, "trace", name)


def read_recording(source: Source, signal: SignalSettings, first: SignalSettings | None = None) -> Channel:
    """Read the recording of one impact: raw values, times in s if the file has any, and rows.

    The channel ``signal.value_column`` holds the values; where that was left at its default, the only
    channel of a file will do. Time is the channel ``signal.time_column``, else the recorder's own clock.

    Args:
        source: the file; its suffix says the format.
        signal: the names of the channels, and how a text is written.
        first: those of the first channel, where this is a further one: see `at_own_clock`.

    Raises:
        InputError: the file is missing, damaged, of an unknown format, or lacks a channel.
    """
    form, label = _format_of(source), source.label
    if form is None:
        wanted = [signal.time_column] if "time_column" in signal.model_fields_set else []
        contents = read_table(
            replace(source, stated=signal),
            numbers=[*wanted, signal.value_column],
            optional=partial(clocks_beside, signal, first),
        )
    else:
        contents = _contents(source, form)
        if len(contents.blocks) > 1:
            blocks = f"{len(contents.blocks)} blocks"
            raise InputError.stated("no-channel.blocks", label, value=blocks, first=f"{label}#1")
        signal = _naming_channels(contents, label, signal)
    contents, signal = at_own_clock(contents, signal, first, label)
    name, channels = signal.value_column, contents.channels
    count, time = channels[name].values.size, channels.get(signal.time_column)
    if count < MIN_SAMPLES and (others := long_enough(channels)):
        limits = {"least": MIN_SAMPLES, "others": ", ".join(others)}
        raise InputError.stated("no-channel.short", label, column=name, value=f"{count} samples", **limits)
    if time is not None and time.values.size != count:
        where = label, None, signal.time_column, time.values.size
        raise InputError.stated("clock-and-channel.count", *where, channel=name, count=count)
    return _with_times(contents, signal)


def _with_times(contents: Contents, signal: SignalSettings) -> Channel:
    """The channel of the values, its clock that of the times, in s, where there are any; with its rows."""
    name, time = signal.value_column, contents.channels.get(signal.time_column)
    value = replace(contents.channels[name], rows=contents.rows_of(name))
    if time is None:
        return value
    clock = time.values if time.since is not None else in_seconds(time.values, signal)
    return replace(value, clock=clock, text={**time.text, **value.text})


def contents_of(source: Source) -> Contents:
    """All channels of numbers in a file or a part of it; of a table every column of numbers.

    Raises:
        InputError: the file is missing, damaged or of an unknown format.
    """
    form = _format_of(source)
    return read_table(source, numbers=None) if form is None else _contents(source, form)


def _format_of(source: Source) -> Format | None:
    """The format of a recorder's file, by its name, else by how it begins; None of a table."""
    suffix = source.suffix
    if suffix in FORMATS and suffix != labview.SUFFIX:
        return FORMATS[suffix]
    begin, is_labview = _begin(source.path), suffix == labview.SUFFIX
    if labview.is_measurement(begin, named=is_labview):
        return FORMATS[labview.SUFFIX]
    # Whoever reads a file that is not there, or empty, says so.
    if is_labview or suffix in _TABLES or is_text_of_numbers(source.path):
        return None
    endings = ", ".join((*SUFFIXES, *TEXT_SUFFIXES))
    raise InputError.stated("recorder-format", source.label, value=source.path.name, endings=endings)


def _begin(path: Path) -> bytes:
    with suppress(OSError, ValueError), path.open("rb") as file:
        return file.read(labview.HEADER)
    return b""


def is_text_of_numbers(path: Path) -> bool:
    """Whether a file of whatever ending is a text that goes on in lines of numbers."""
    begin = _begin(path)
    if b"\0" in begin or not begin.strip():
        return False
    lines = begin.splitlines()[:-1] or begin.splitlines()
    cells = [cell for line in lines[len(lines) // 2 :] for cell in re.split(rb"[\s,;|]+", line) if cell]
    numbers = sum(not isnan(number_in(cell.decode("latin-1"))) for cell in cells)
    return len(lines) >= MIN_SAMPLES and numbers > 0.8 * len(cells)


def long_enough(channels: Mapping[str, Channel]) -> list[str]:
    """The channels that can be recordings of an impact: `MIN_SAMPLES` samples or more."""
    return [name for name, channel in channels.items() if channel.values.size >= MIN_SAMPLES]


def _contents(source: Source, form: Format) -> Contents:
    data, label = source.read(share=form.share), source.label
    suffix = source.suffix if source.suffix in form.suffixes else form.suffixes[0]
    with decoded("recorder", label, suffix=suffix), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            contents = form.read(data, label)
        except UnfitError as error:
            raise InputError.stated(error.key, label, value=error.value, **error.words) from None
    if not source.part:
        return contents
    blocks = contents.blocks or (contents,)
    if not 1 <= int(source.part) <= len(blocks):
        raise InputError.stated("no-channel.block", label, value=f"#{source.part}", count=len(blocks))
    return blocks[int(source.part) - 1]


def _naming_channels(contents: Contents, label: str, signal: SignalSettings) -> SignalSettings:
    """The settings with the channel of a recorder's file that holds the values.

    Raises:
        InputError: the file has no such channel, or none with times that are named.
    """
    problems, channels = [], contents.channels
    name = signal.value_column
    if name not in channels and "value_column" not in signal.model_fields_set:
        others = [channel for channel in long_enough(channels) if channel != signal.time_column]
        name = others[0] if len(others) == 1 else name
    for key, wanted in (("value_column", name), ("time_column", signal.time_column)):
        if wanted not in channels and (key == "value_column" or key in signal.model_fields_set):
            listed = ", ".join(channels) or "no channels of numbers"
            problems.append(Problem.stated("no-channel.named", label, None, wanted, listed, setting=key))
    refuse(problems)
    return signal.model_copy(update={"value_column": name})


def clocks_among(names: Sequence[str]) -> list[str]:
    """The names that say time, and state no unit of anything else."""
    units = {name: unit_in_name(name) for name in names if _NAMED.search(name)}
    return [name for name, unit in units.items() if dimension_of(unit) in (None, "time")]


def at_own_clock(
    contents: Contents, signal: SignalSettings, first: SignalSettings | None, label: str
) -> tuple[Contents, SignalSettings]:
    """The contents with a further channel's times by the first one's clock, and settings with their name.

    They are in the unit and since the beginning of the first channel's times.

    Args:
        contents: of the file, at least what is among `clocks_beside`.
        signal: the settings of the channel.
        first: those of the first one; None where this is the first, or has a table of its own.
        label: what to call the file in a message.

    Raises:
        InputError: times that differ could all be the channel's.
    """
    columns, name = contents.channels, signal.time_column
    if first is None or (shared := columns.get(first.time_column)) is None:
        return contents, signal
    if name == first.time_column:
        name = _own_clock(contents, signal, first, label)
    times = _as_beside(columns[name], name, shared, first)
    contents = replace(contents, channels=columns | {name: times})
    return contents, signal.model_copy(update={"time_column": name})


def _own_clock(contents: Contents, signal: SignalSettings, first: SignalSettings, label: str) -> str:
    """The name of a further channel's times; arguments and what is raised as of `at_own_clock`.

    Where the values of each channel stand behind times of their own, these are the nearest before them. Where
    the places do not tell, the first channel's times, if no others contradict them.
    """
    names, columns = contents.names, contents.channels
    shared = columns[first.time_column]
    named = [name for name in names if name in {*clocks_among(names), first.time_column}]
    clocks = [name for name in named if name in columns and _rises(columns[name], shared)]

    def before(value: str) -> str | None:
        above = names[: names.index(value)] if value in names else ()
        return next((name for name in reversed(above) if name in clocks), None)

    nearest, of_first = before(signal.value_column), before(first.value_column)
    if nearest is not None and nearest != of_first == first.time_column:
        return nearest
    # Times that no column of values stands behind.
    alone = {name for name, behind in pairwise([*names, first.time_column]) if behind in clocks}
    for name in clocks:
        times = _as_beside(columns[name], name, shared, first)
        if name in alone | {nearest, of_first} and _contradict(shared.values, times.values):
            where = label, None, None, ", ".join(clocks)
            raise InputError.stated("clock-and-channel.which", *where, channel=signal.value_column)
    return first.time_column


def clocks_beside(signal: SignalSettings, first: SignalSettings | None, names: Sequence[str]) -> list[str]:
    """Which columns of times are read beside a channel: its own, and of a further one all of `at_own_clock`.

    Args:
        signal: the settings of the channel.
        first: those of the first channel; None where this is the first, or has a table of its own.
        names: of all columns of the table.
    """
    clocks = [signal.time_column]
    if first is not None and first.time_column in names:
        clocks += [first.time_column, *clocks_among(names)]
    return list(dict.fromkeys(clocks))


def _rises(times: Channel, like: Channel) -> bool:
    known = times.values[np.isfinite(times.values)]
    same = (times.since is None) == (like.since is None)
    return same and known.size > 1 and bool(known[-1] > known[0])


def _as_beside(times: Channel, name: str, shared: Channel, first: SignalSettings) -> Channel:
    """Times in the unit of others; times of day since the beginning of these."""
    if times.since is not None and shared.since is not None:
        return replace(times, values=times.values + within_a_day(times.since - shared.since))
    units = (times.unit or unit_in_name(name), shared.unit or unit_in_name(first.time_column))
    if units[0] == units[1] or {dimension_of(unit, ["time"]) for unit in units} != {"time"}:
        return times
    return replace(times, values=times.values * (to_si(units[0], "time") / to_si(units[1], "time")))


def _contradict(times: np.ndarray, others: np.ndarray) -> bool:
    """Whether two clocks ran at the same time, and show other times for the same rows."""
    times, others = (clock[np.isfinite(clock)] for clock in (times, others))
    together = max(times.min(), others.min()) < min(times.max(), others.max())
    step = np.ptp(times) / (times.size - 1)
    return bool(together and (times.size != others.size or np.abs(times - others).max() > _ALIKE * step))
