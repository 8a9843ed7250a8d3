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
from bayestissue.dataset.dialect import Stated
from bayestissue.dataset.files import error_line, of_part, read_bytes
from bayestissue.dataset.formats import (
    FORMATS,
    Channel,
    Contents,
    UnfitError,
    even_clock,
    labview,
    unit_in_name,
)
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import TABLE_SUFFIXES, TEXT_SUFFIXES, Columns, Numbers, read_table
from bayestissue.dataset.traces import MIN_SAMPLES, in_seconds
from bayestissue.dataset.units import dimension_of, to_si
from bayestissue.errors import InputError, Problem, refuse

REMEDY = "Correct the cell in column trace of impacts.csv, or put the file there."
_TABLES = (*TABLE_SUFFIXES, *TEXT_SUFFIXES)
SUFFIXES = (*TABLE_SUFFIXES, *FORMATS)
# Names of columns that say time.
_NAMED = re.compile(
    r"(?:^|[\W_])(?:time|timestamp|elapsed|zeit|uhrzeit|temps|tiempo|tempo|t)(?:[\W_\d]|$)", re.IGNORECASE
)
# Of a sampling interval: times that differ by less are alike.
_ALIKE = 0.25
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def read_recording(
    path: Path, label: str, signal: SignalSettings, first: SignalSettings | None = None
) -> Channel:
    """Read the recording of one impact: raw values, times in s if the file has any, and rows.

    The channel ``signal.value_column`` holds the values; where that was left at its default, the only
    channel of a file will do. Time is the channel ``signal.time_column``, else the recorder's own clock.

    Args:
        path: the file; its suffix says the format.
        label: what to call it in a message.
        signal: the names of the channels.
        first: those of the first channel, where this is a further one: see `own_clock`.

    Raises:
        InputError: the file is missing, damaged, of an unknown format, or lacks a channel.
    """
    if _is_table(path):
        return _from_table(path, label, signal, first)
    contents = _contents(path, label)
    if contents.blocks:
        value, part = f"{len(contents.blocks)} blocks", f"{label}#1"
        raise InputError.stated("no-channel.blocks", label, value=value, first=part)
    return _pick(contents, label, signal, first)


def suffix_of(path: Path) -> str:
    """What a file's name says of its format: how it ends, in small letters."""
    path, _ = of_part(path)
    return "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()


def contents_of(path: Path, label: str, stated: Stated | None = None) -> Contents:
    """All channels of numbers in a file; of a table every column in which most cells hold a number.

    Args:
        path: the file, or a part of it: see `of_part`; its suffix says the format.
        label: what to call it in a message.
        stated: how a text is written, as far as somebody said so.

    Raises:
        InputError: the file is missing, damaged or of an unknown format.
    """
    if not _is_table(path):
        return _contents(path, label)
    numbers = read_table(path, label, numbers=None, remedy=REMEDY, stated=stated)
    channels = {}
    for name, column in numbers.numbers.items():
        values = _to_its_end(column.array)
        clock = _clock(numbers, values.size)
        channels[name] = Channel(values, clock, column.unit or unit_in_name(name))
    return Contents(channels, numbers.first_row, str(numbers.dialect or ""))


def _is_table(path: Path) -> bool:
    """Whether a file is a table of text or cells: by its name, else by how it begins."""
    suffix = suffix_of(path)
    if suffix in FORMATS and suffix != labview.SUFFIX:
        return False
    begin = _begin(path)
    # Whoever reads a file that is not there, or empty, says so.
    if labview.is_measurement(begin):
        return False
    if suffix == labview.SUFFIX:
        return labview.is_headerless(begin)
    return suffix in _TABLES or is_text_of_numbers(path)


def _begin(path: Path) -> bytes:
    with suppress(OSError, ValueError), of_part(path)[0].open("rb") as file:
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


def _to_its_end(values: np.ndarray) -> np.ndarray:
    """A column without the empty cells behind its end, where others of the table are longer."""
    filled = np.flatnonzero(np.isfinite(values))
    return values[: filled[-1] + 1] if filled.size else values


def _clock(table: Columns, samples: int) -> np.ndarray | None:
    return even_clock(table.clock[1], table.clock[0], samples) if table.clock else None


def long_enough(channels: Mapping[str, Channel]) -> list[str]:
    """The channels that can be recordings of an impact: `MIN_SAMPLES` samples or more."""
    return [name for name, channel in channels.items() if channel.values.size >= MIN_SAMPLES]


def _contents(path: Path, label: str) -> Contents:
    suffix = suffix_of(path)
    if suffix in _TABLES or (suffix not in FORMATS and labview.is_measurement(_begin(path))):
        suffix = labview.SUFFIX
    if suffix not in FORMATS:
        endings = ", ".join((*SUFFIXES, *TEXT_SUFFIXES))
        raise InputError.stated("recorder-format", label, value=path.name, endings=endings)
    data = read_bytes(path, label, REMEDY, share=FORMATS[suffix].share)
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
    part = of_part(path)[1]
    if not part:
        return contents
    # A file of one recording has it as its first part too.
    blocks = contents.blocks or (contents,)
    if not 1 <= int(part) <= len(blocks):
        raise InputError.stated("no-channel.block", label, value=f"#{part}", count=len(blocks))
    return blocks[int(part) - 1]


def _from_table(path: Path, label: str, signal: SignalSettings, first: SignalSettings | None) -> Channel:
    columns = {"numbers": [signal.time_column, signal.value_column]}
    if "time_column" not in signal.model_fields_set:
        columns = {"numbers": [signal.value_column], "optional": [signal.time_column]}
    read = partial(read_table, path, label, remedy=REMEDY, stated=signal)
    table, signal = with_own_clock(partial(read, **columns), signal, first, label)
    value, time = table.numbers[signal.value_column], table.numbers.get(signal.time_column)
    count, text = value.array.size, {**(time.text if time else {}), **value.text}
    clock = _clock(table, count)
    if time is not None:
        clock = time.array if time.seconds else in_seconds(time.array, signal)
    return Channel(value.array, clock, rows=table.first_row + np.arange(count), text=text)


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
        clocks = {
            key: Numbers(channels[key].values, unit=channels[key].unit)
            for key in {*clocks_among([*channels]), first.time_column} & {*channels}
        }
        _, own = own_clock([*channels], clocks, signal, first, label)
        time = Channel(own.array) if own else time
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


def own_clock(
    names: Sequence[str],
    columns: Mapping[str, Numbers],
    signal: SignalSettings,
    first: SignalSettings,
    label: str,
) -> tuple[str, Numbers | None]:
    """The name and the times of a channel, in the unit and since the beginning of the first one's.

    Where the values of each channel stand behind times of their own, these are the nearest before them. Where
    the places do not tell, the first channel's times, if no others contradict them.

    Args:
        names: of all columns, in the order of the file.
        columns: those of `clocks_among`, and both channels' times.
        signal: the settings of the channel.
        first: those of the first one; of itself where there is one channel.
        label: what to call the file in a message.

    Raises:
        InputError: times that differ could all be the channel's.
    """
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
        if name in alone | {own, of_first} and _contradict(shared.array, times.array):
            listed = ", ".join(clocks)
            raise InputError.stated(
                "clock-and-channel.which", label, value=listed, channel=signal.value_column
            )
    return first.time_column, shared


def with_own_clock(
    read: Callable[..., Columns], signal: SignalSettings, first: SignalSettings | None, label: str
) -> tuple[Columns, SignalSettings]:
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
    name, times = own_clock(table.names, table.numbers, signal, first, label)
    if times is None:
        return table, signal
    return replace(table, numbers=table.numbers | {name: times}), signal.model_copy(
        update={"time_column": name}
    )


def _rises(times: Numbers, like: Numbers) -> bool:
    known = times.array[np.isfinite(times.array)]
    return times.seconds == like.seconds and known.size > 1 and bool(known[-1] > known[0])


def _as_beside(times: Numbers, name: str, shared: Numbers | None, first: SignalSettings) -> Numbers:
    """Times in the unit of others; times of day since the beginning of these."""
    if shared is None:
        return times
    if times.seconds and shared.seconds:
        late = within_a_day(times.start - shared.start)
        return replace(times, array=times.array + late)
    units = (times.unit or unit_in_name(name), shared.unit or unit_in_name(first.time_column))
    if units[0] == units[1] or {dimension_of(unit, ["time"]) for unit in units} != {"time"}:
        return times
    return replace(times, array=times.array * (to_si(units[0], "time") / to_si(units[1], "time")))


def _contradict(times: np.ndarray, others: np.ndarray) -> bool:
    """Whether two clocks ran at the same time, and show other times for the same rows."""
    times, others = (each[np.isfinite(each)] for each in (times, others))
    together = max(times.min(), others.min()) < min(times.max(), others.max())
    step = np.ptp(times) / (times.size - 1)
    return bool(together and (times.size != others.size or np.abs(times - others).max() > _ALIKE * step))
