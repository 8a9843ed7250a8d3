"""One impact out of a recorder's file: a table (CSV, Parquet) or one of `bayestissue.dataset.formats`."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from bayestissue.dataset.clock_times import within_a_day
from bayestissue.dataset.files import Source, error_line
from bayestissue.dataset.formats import (
    FORMATS,
    Channel,
    Contents,
    UnfitError,
    labview,
    unit_in_name,
)
from bayestissue.dataset.recordings import in_seconds
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import TABLE_SUFFIXES, TEXT_SUFFIXES, read_table
from bayestissue.dataset.traces import MIN_SAMPLES
from bayestissue.dataset.units import dimension_of, to_si
from bayestissue.errors import InputError, Problem, refuse

_TABLES = (*TABLE_SUFFIXES, *TEXT_SUFFIXES)
SUFFIXES = (*TABLE_SUFFIXES, *FORMATS)
# Names of columns that say time.
_NAMED = re.compile(
    r"(?:^|[\W_])(?:time|timestamp|elapsed|zeit|uhrzeit|temps|tiempo|tempo|t)(?:[\W_\d]|$)", re.IGNORECASE
)
# Of a sampling interval: times that differ by less are alike.
_ALIKE = 0.25
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def read_recording(source: Source, signal: SignalSettings, first: SignalSettings | None = None) -> Channel:
    """Read the recording of one impact: raw values, times in s if the file has any, and rows.

    The channel ``signal.value_column`` holds the values; where that was left at its default, the only
    channel of a file will do. Time is the channel ``signal.time_column``, else the recorder's own clock.

    Args:
        source: the file; its suffix says the format.
        signal: the names of the channels, and how a text is written.
        first: those of the first channel, where this is a further one: see `own_clock`.

    Raises:
        InputError: the file is missing, damaged, of an unknown format, or lacks a channel.
    """
    if _is_table(source):
        return _from_table(replace(source, stated=signal), signal, first)
    contents = _contents(source)
    if len(contents.blocks) > 1:
        value, part = f"{len(contents.blocks)} blocks", f"{source.label}#1"
        raise InputError.stated("no-channel.blocks", source.label, value=value, first=part)
    return _pick(contents, source.label, signal, first)


def contents_of(source: Source) -> Contents:
    """All channels of numbers in a file or a part of it; of a table every column of numbers.

    Raises:
        InputError: the file is missing, damaged or of an unknown format.
    """
    if not _is_table(source):
        return _contents(source)
    table = read_table(source, numbers=None)
    return replace(table, channels={name: _whole(name, table.channels[name]) for name in table.channels})


def _is_table(source: Source) -> bool:
    """Whether a file is a table of text or cells: by its name, else by how it begins."""
    suffix = source.suffix
    if suffix in FORMATS and suffix != labview.SUFFIX:
        return False
    begin = _begin(source.path)
    # Whoever reads a file that is not there, or empty, says so.
    if labview.is_measurement(begin):
        return False
    if suffix == labview.SUFFIX:
        return labview.is_headerless(begin)
    return suffix in _TABLES or is_text_of_numbers(source.path)


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
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
    return len(lines) >= MIN_SAMPLES and numbers > 0.8 * len(cells)


def _whole(name: str, column: Channel) -> Channel:
    """A column with its unit, without empty cells behind its end, where others of the table are longer."""
    count = int(np.flatnonzero(np.isfinite(column.values))[-1]) + 1
    clock = None if column.clock is None else column.clock[:count]
    return replace(column, values=column.values[:count], clock=clock, unit=column.unit or unit_in_name(name))


def long_enough(channels: Mapping[str, Channel]) -> list[str]:
    """The channels that can be recordings of an impact: `MIN_SAMPLES` samples or more."""
    return [name for name, channel in channels.items() if channel.values.size >= MIN_SAMPLES]


def _contents(source: Source) -> Contents:
    suffix, label = source.suffix, source.label
    if suffix in _TABLES or (suffix not in FORMATS and labview.is_measurement(_begin(source.path))):
        suffix = labview.SUFFIX
    if suffix not in FORMATS:
        endings = ", ".join((*SUFFIXES, *TEXT_SUFFIXES))
        raise InputError.stated("recorder-format", label, value=source.path.name, endings=endings)
    data = source.read(share=FORMATS[suffix].share)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            contents = FORMATS[suffix].read(data, label)
    except UnfitError as error:
        words = {"expected": error.expected, "remedy": error.remedy}
        raise InputError.stated("recorder-file", label, value=error.value, **words) from None
    except InputError:
        raise
    except Exception as error:
        # Damaged bytes can fail anywhere in a decoder, with whatever that part of it raises.
        line = error_line(error)
        raise InputError.stated("damaged-file.recorder", label, value=line, suffix=suffix) from error
    if not source.part:
        return contents
    blocks = contents.blocks or (contents,)
    if not 1 <= int(source.part) <= len(blocks):
        raise InputError.stated("no-channel.block", label, value=f"#{source.part}", count=len(blocks))
    return blocks[int(source.part) - 1]


def _from_table(source: Source, signal: SignalSettings, first: SignalSettings | None) -> Channel:
    columns = {"numbers": [signal.time_column, signal.value_column]}
    if "time_column" not in signal.model_fields_set:
        columns = {"numbers": [signal.value_column], "optional": [signal.time_column]}
    read = partial(read_table, source, **columns)
    table, signal = with_own_clock(read, signal, first, source.label)
    value, time = table.channels[signal.value_column], table.channels.get(signal.time_column)
    rows = table.first_row + np.arange(value.values.size)
    if time is None:
        return replace(value, rows=rows)
    return replace(value, clock=times_of(time, signal), rows=rows, text={**time.text, **value.text})


def _pick(contents: Contents, label: str, signal: SignalSettings, first: SignalSettings | None) -> Channel:
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
    value, time = channels[name], channels.get(signal.time_column)
    if time is not None and first is not None:
        _, time = own_clock(contents, signal, first, label)
    count = value.values.size
    if count < MIN_SAMPLES and (others := long_enough(channels)):
        limits = {"least": MIN_SAMPLES, "others": ", ".join(others)}
        raise InputError.stated("no-channel.short", label, column=name, value=f"{count} samples", **limits)
    if time is not None and time.values.size != count:
        where = label, None, signal.time_column, time.values.size
        raise InputError.stated("clock-and-channel.count", *where, channel=name, count=count)
    clock = value.clock if time is None else in_seconds(time.values, signal)
    rows = contents.first_row + np.arange(count) if value.rows is None else value.rows
    return Channel(value.values, clock, rows=rows)


def clocks_among(names: Sequence[str]) -> list[str]:
    """The names that say time, and state no unit of anything else."""
    units = {name: unit_in_name(name) for name in names if _NAMED.search(name)}
    return [name for name, unit in units.items() if dimension_of(unit) in (None, "time")]


def times_of(column: Channel, signal: SignalSettings) -> np.ndarray:
    """The times that a column holds, s."""
    return column.values if column.since is not None else in_seconds(column.values, signal)


def own_clock(
    contents: Contents, signal: SignalSettings, first: SignalSettings, label: str
) -> tuple[str, Channel | None]:
    """The name and the times of a channel, in the unit and since the beginning of the first one's.

    Where the values of each channel stand behind times of their own, these are the nearest before them. Where
    the places do not tell, the first channel's times, if no others contradict them.

    Args:
        contents: of the file, at least what is among `clocks_among` and both channels' times.
        signal: the settings of the channel.
        first: those of the first one; of itself where there is one channel.
        label: what to call the file in a message.

    Raises:
        InputError: times that differ could all be the channel's.
    """
    names, columns = contents.names, contents.channels
    shared = columns.get(first.time_column)
    if signal.time_column != first.time_column or shared is None:
        times = columns.get(signal.time_column)
        return signal.time_column, times if times is None else _as_beside(
            times, signal.time_column, shared, first
        )
    named = [name for name in names if name in {*clocks_among(names), first.time_column}]
    clocks = [name for name in named if name in columns and _rises(columns[name], shared)]

    def before(value: str) -> str | None:
        above = names[: names.index(value)] if value in names else ()
        return next((name for name in reversed(above) if name in clocks), None)

    own, of_first = before(signal.value_column), before(first.value_column)
    if own is not None and own != of_first == first.time_column:
        return own, _as_beside(columns[own], own, shared, first)
    # Times that no column of values stands behind.
    alone = {name for name, behind in pairwise([*names, first.time_column]) if behind in clocks}
    for name in clocks:
        times = _as_beside(columns[name], name, shared, first)
        if name in alone | {own, of_first} and _contradict(shared.values, times.values):
            listed = ", ".join(clocks)
            raise InputError.stated(
                "clock-and-channel.which", label, value=listed, channel=signal.value_column
            )
    return first.time_column, shared


def with_own_clock(
    read: Callable[..., Contents], signal: SignalSettings, first: SignalSettings | None, label: str
) -> tuple[Contents, SignalSettings]:
    """A table, a further channel's times by `own_clock`; and the settings with their name.

    Args:
        read: reads the channel's columns, and ``optional`` further ones.
        signal: the settings of the channel.
        first: those of the first channel; None where this is the first, or has a table of its own.
        label: what to call the file in a message.
    """
    table = read()
    others = {*clocks_among(table.names), signal.time_column} - {first.time_column if first else ""}
    if first is None or not others or first.time_column not in table.names:
        return table, signal
    table = read(optional=list({*clocks_among(table.names), first.time_column, signal.time_column}))
    name, times = own_clock(table, signal, first, label)
    if times is None:
        return table, signal
    table = replace(table, channels=table.channels | {name: times})
    return table, signal.model_copy(update={"time_column": name})


def _rises(times: Channel, like: Channel) -> bool:
    known = times.values[np.isfinite(times.values)]
    same = (times.since is None) == (like.since is None)
    return same and known.size > 1 and bool(known[-1] > known[0])


def _as_beside(times: Channel, name: str, shared: Channel | None, first: SignalSettings) -> Channel:
    """Times in the unit of others; times of day since the beginning of these."""
    if shared is None:
        return times
    if times.since is not None and shared.since is not None:
        return replace(times, values=times.values + within_a_day(times.since - shared.since))
    units = (times.unit or unit_in_name(name), shared.unit or unit_in_name(first.time_column))
    if units[0] == units[1] or {dimension_of(unit, ["time"]) for unit in units} != {"time"}:
        return times
    return replace(times, values=times.values * (to_si(units[0], "time") / to_si(units[1], "time")))


def _contradict(times: np.ndarray, others: np.ndarray) -> bool:
    """Whether two clocks ran at the same time, and show other times for the same rows."""
    times, others = (each[np.isfinite(each)] for each in (times, others))
    together = max(times.min(), others.min()) < min(times.max(), others.max())
    step = np.ptp(times) / (times.size - 1)
    return bool(together and (times.size != others.size or np.abs(times - others).max() > _ALIKE * step))
