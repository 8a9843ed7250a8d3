"""One impact out of a recorder's file: a table (CSV, Parquet) or one of `bayestissue.dataset.formats`."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int

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
from bayestissue.dataset.own_clock import clocks_among, own_clock, with_own_clock
from bayestissue.dataset.recordings import MIN_SAMPLES
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import TABLE_SUFFIXES, TEXT_SUFFIXES, Columns, Numbers, read_table
from bayestissue.errors import InputError, Problem, refuse

REMEDY = "Correct the cell in column trace of impacts.csv, or put the file there."
_TABLES = (*TABLE_SUFFIXES, *TEXT_SUFFIXES)
SUFFIXES = (*TABLE_SUFFIXES, *FORMATS)
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Recording:
    """What a file holds of one impact, in the recorder's units.

    Attributes:
        value: the raw samples.
        time: the time channel in the dataset's time unit, if the file has one.
        clock: the recorder's own time in s, if the format carries one and there is no time channel.
        first_row: the row, or in a binary file the number, of the first sample.
        rows: of each sample, where they do not follow one another.
        text: what stood in cells that held no number, by the index of the sample.
    """

    value: Float64[np.ndarray, " sample"]
    time: Float64[np.ndarray, " sample"] | None = None
    clock: Float64[np.ndarray, " sample"] | None = None
    first_row: int = 1
    rows: Int[np.ndarray, " sample"] | None = None
    text: dict[int, str] = field(default_factory=dict)


def read_recording(
    path: Path, label: str, signal: SignalSettings, first: SignalSettings | None = None
) -> Recording:
    """Read the recording of one impact.

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


def _from_table(path: Path, label: str, signal: SignalSettings, first: SignalSettings | None) -> Recording:
    columns = {"numbers": [signal.time_column, signal.value_column]}
    if "time_column" not in signal.model_fields_set:
        columns = {"numbers": [signal.value_column], "optional": [signal.time_column]}
    read = partial(read_table, path, label, remedy=REMEDY, stated=signal)
    table, signal = with_own_clock(partial(read, **columns), signal, first, label)
    value, time = table.numbers[signal.value_column], table.numbers.get(signal.time_column)
    return Recording(
        value.array,
        None if time is None or time.seconds else time.array,
        time.array if time is not None and time.seconds else _clock(table, value.array.size),
        first_row=table.first_row,
        text={**(time.text if time else {}), **value.text},
    )


def _pick(contents: Contents, label: str, signal: SignalSettings, first: SignalSettings | None) -> Recording:
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
    return Recording(
        value.values,
        None if time is None else time.values,
        value.clock if time is None else None,
        first_row=contents.first_row,
        rows=value.rows,
    )
