"""Files of National Instruments: LabVIEW measurements, ``.lvm``, and ``.tdms``."""

from __future__ import annotations

import io
import logging
import re
from codecs import BOM_UTF8
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from bayestissue.dataset.files import require_small
from bayestissue.dataset.formats.channel import Channel, Contents, Format, UnfitError, even_clock

SUFFIX = ".lvm"
# As many bytes as show whether a text is LabVIEW's: it begins with its name, and a header has an end.
HEADER = 1 << 14
_MEASUREMENT, _END = b"LabVIEW Measurement", b"***End_of_Header***"
# Where a file's header begins; where that of a block does, with its notes; the line above the numbers; and
# lines of empty cells.
_FILE = re.compile(r"^LabVIEW Measurement", re.MULTILINE)
_CHANNELS = re.compile(r"(?:^[A-Za-z].*\n)*^Channels\b", re.MULTILINE)
_NAMES = re.compile(r"^X_Value.*\n?", re.MULTILINE)
_DAY_S = 86_400.0
_EMPTY = re.compile(r"(?:^[\t,;]?\r?\n)+", re.MULTILINE)


def is_measurement(begin: bytes) -> bool:
    """Whether a file that begins so is a LabVIEW measurement with its header."""
    return begin.removeprefix(BOM_UTF8).startswith(_MEASUREMENT)


def is_headerless(begin: bytes) -> bool:
    """Whether a text that begins so has no header, and is a table then."""
    return bool(begin.strip()) and _END not in begin


def read_lvm(data: bytes, label: str) -> Contents:
    """The channels of a file of one recording; the ``blocks`` of a file of several.

    A block of data has a header of its own, or it has as many rows as the header before it states, behind an
    empty line or where ``X_Value`` begins again. Blocks of which each begins one sampling interval after the
    end of the one before are one recording: LabVIEW writes a long one in segments. The clock of a channel is
    ``X_Value``, else ``X0`` and ``Delta_X``, and later by what its ``Time`` is behind that of the first
    channel. Channels may differ in the number of samples and in their
    interval: cells behind the end of a short one are empty.
    """
    recordings = _recordings(data)
    return recordings[0] if len(recordings) == 1 else Contents({}, blocks=recordings)


# The blocks of a file are asked for one by one, each time with the whole of it.
@lru_cache(maxsize=1)
def _recordings(data: bytes) -> tuple[Contents, ...]:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        # LabVIEW writes names and units in the code page of its machine; the numbers are plain.
        text = data.decode("latin-1")
    recordings: list[list[Contents]] = []
    for piece in chain.from_iterable(map(_pieces, _blocks(text.removeprefix("\ufeff")))):
        if not recordings or not _goes_on(recordings[-1][-1], piece):
            recordings.append([])
        recordings[-1].append(piece)
    return tuple(map(_joined, recordings))


class _Block(NamedTuple):
    """A block of data as text.

    Attributes:
        text: the file's header, that of the block, and rows of numbers.
        first_row: the first of these in the file.
        has_header: whether its own header stands above it, and not that of the block before.
    """

    text: str
    first_row: int
    has_header: bool


def _blocks(text: str) -> Iterator[_Block]:
    """Every block of data, under the headers that hold for it.

    Raises:
        UnfitError: there are no numbers below a header, as where a file was cut short.
    """
    row, counted = 1, 0
    for begin, end in _from_each(_FILE, text, 0, len(text)):
        header_end = text.find(_END.decode(), begin, end)
        parts = list(_from_each(_CHANNELS, text, max(header_end, begin), end))
        header = _EMPTY.sub("", text[begin : parts[0][0] if parts else end])
        for start, stop in parts or [(end, end)]:
            names = _NAMES.search(text, start, stop)
            numbers = [] if names is None else list(_between_empty(text, names.end(), stop))
            if names is None or not numbers:
                where = f"none below the header that ends in row {row + text.count('\n', counted, stop)}"
                raise UnfitError("numbers below every header", "Copy or export the recording anew.", where)
            for first, last in numbers:
                row, counted = row + text.count("\n", counted, first), first
                above = text[start : names.end()]
                yield _Block(f"{header}\n{above}{text[first:last]}", row, first == numbers[0][0])


def _from_each(mark: re.Pattern[str], text: str, begin: int, end: int) -> Iterator[tuple[int, int]]:
    """The stretches from each line with a mark to the next."""
    return pairwise([*(match.start() for match in mark.finditer(text, begin, end)), end])


def _between_empty(text: str, begin: int, end: int) -> Iterator[tuple[int, int]]:
    """The stretches between empty lines."""
    gaps = [(gap.start(), gap.end()) for gap in _EMPTY.finditer(text, begin, end)]
    for (_, first), (last, _) in pairwise([(begin, begin), *gaps, (end, end)]):
        if first < last:
            yield first, last


def _pieces(block: _Block) -> Iterator[Contents]:
    """The channels of a block; of each piece of one whose ``X_Value`` begins again."""
    import lvm_read

    content: dict[Any, Any] = lvm_read.read_str(_with_decimal_mark(block.text))
    segment = content[0]
    samples, names = segment["data"], segment["Channel names"]
    if not block.has_header and "X_Value" not in names:
        expected = "a header, or times in a column X_Value, of every piece"
        where = f"neither of the one from row {block.first_row} on"
        raise UnfitError(expected, "Export with one header for each segment, or with an X column.", where)
    if unit := set(segment.get("X_Dimension", [])) - {"Time", ""}:
        raise UnfitError("time along X", "Export the signal over time.", ", ".join(sorted(unit)))
    stated = [int(count) for count in segment.get("Samples", []) if count == count]
    greatest = max(stated, default=0)
    begins = _begins_again(samples, names) if len(samples) > greatest > 0 else []
    bounds = [0, *begins, len(samples)]
    for first, last in pairwise(bounds):
        rows = last - first
        # The one header may be that of the first of many pieces, over all of which X_Value goes on.
        several = greatest > 0 and rows > greatest and "X_Value" in names
        if stated and rows != greatest and (not several or (begins and rows % greatest)):
            raise UnfitError(
                "as many rows as the header's greatest Samples",
                "Export the recording anew.",
                f"{rows} rows where {greatest} are stated",
            )
        counts = [] if several else stated
        yield _channels(segment, samples[first:last], counts, block.first_row + first)


def _channels(
    segment: dict[str, Any], samples: Float64[np.ndarray, "row column"], stated: list[int], first_row: int
) -> Contents:
    """The channels of rows of numbers; ``stated`` is how many samples each has, if its header says so."""
    names = segment["Channel names"]
    if len(names) > 1 and names[-1] == "Comment":
        names = names[:-1]
    channels: dict[str, Channel] = {}
    x, of_x = None, None
    measured = 0
    for column, name in enumerate(names):
        start, step = _stated(segment, "X0", measured, 0.0), _stated(segment, "Delta_X", measured, None)
        late = _behind_first(segment, measured, start)
        if name == "X_Value":
            x, of_x = samples[:, column], (start, step, late)
            continue
        count = stated[measured] if measured < len(stated) else len(samples)
        if np.isfinite(samples[count:, column]).any():
            expected = f"empty cells behind the {count} Samples of channel {name}"
            raise UnfitError(expected, "Export the recording anew.", "numbers behind them")
        # One column X_Value is the clock of channels that begin and go on as the one beside it does.
        has_times = x is not None and of_x == (start, step, late) and np.isfinite(x[:count]).any()
        clock = x[:count] if x is not None and has_times else even_clock(step, start, count)
        clock = clock + late if clock is not None and late else clock
        unit = _stated(segment, "Y_Unit_Label", measured, "")
        channels[name] = Channel(samples[:count, column], clock, unit if isinstance(unit, str) else "")
        measured += 1
    return Contents(channels, first_row)


def _behind_first(segment: dict[str, Any], channel: int, start: object) -> float:
    """By what a channel's ``Time`` is behind that of the first, s; 0 where X counts from a day long ago."""
    begun, own = (_time_of_day(_stated(segment, "Time", number, "")) for number in (0, channel))
    if begun is None or own is None or not isinstance(start, (int, float)) or start > _DAY_S:
        return 0.0
    # Of two days, of which one began between.
    return (own - begun + _DAY_S / 2) % _DAY_S - _DAY_S / 2


def _time_of_day(cell: object) -> float | None:
    parts = re.fullmatch(r"(\d+):(\d+):(\d+(?:[.,]\d*)?)", str(cell).strip())
    return 3600 * int(parts[1]) + 60 * int(parts[2]) + float(parts[3].replace(",", ".")) if parts else None


def _goes_on(before: Contents, after: Contents) -> bool:
    """Whether every channel begins one sampling interval after the end of that of the block before."""
    units = [{name: c.unit for name, c in piece.channels.items()} for piece in (before, after)]
    pairs = zip(before.channels.values(), after.channels.values(), strict=False)
    return units[0] == units[1] and all(_follows(first.clock, second.clock) for first, second in pairs)


def _follows(
    before: Float64[np.ndarray, " sample"] | None, after: Float64[np.ndarray, " sample"] | None
) -> bool:
    if before is None or after is None or not before.size or not after.size:
        return False
    gap, longer = after[0] - before[-1], max(before, after, key=len)
    if longer.size == 1:
        return bool(gap > 0)
    step = (longer[-1] - longer[0]) / (longer.size - 1)
    return bool(0.5 * step < gap < 1.5 * step)


def _joined(pieces: Sequence[Contents]) -> Contents:
    """Blocks that are one recording, each sample with its row in the file."""
    if len(pieces) == 1:
        return pieces[0]
    channels = {}
    for name, first in pieces[0].channels.items():
        parts = [(piece.first_row, piece.channels[name]) for piece in pieces]
        values = np.concatenate([part.values for _, part in parts])
        clock = np.concatenate([part.clock for _, part in parts if part.clock is not None])
        rows = np.concatenate([row + np.arange(part.values.size) for row, part in parts])
        channels[name] = Channel(values, clock, first.unit, rows)
    return Contents(channels, pieces[0].first_row)


def _with_decimal_mark(text: str) -> str:
    """The text with an entry of its decimal mark, where it has none and numbers have commas."""
    begin = text.find("X_Value")
    header, numbers = text[:begin], text[begin:]
    commas = re.search(r"\d,\d", numbers) and not re.search(r"\d\.\d", numbers)
    if begin < 0 or not commas or re.search(r"^(Decimal_Separator|Separator,)", header, re.MULTILINE):
        return text
    first, end, following = text.partition("\n")
    return f"{first}{end}Decimal_Separator\t,\n{following}"


def _begins_again(samples: np.ndarray, names: list[str]) -> list[int]:
    """The rows in which a column ``X_Value`` begins again."""
    clocks = samples[:, [at for at, name in enumerate(names) if name == "X_Value"]]
    return (np.flatnonzero((np.diff(clocks, axis=0) <= 0).any(axis=1)) + 1).tolist()


def _stated(segment: dict[str, Any], key: str, channel: int, otherwise: Any) -> Any:
    cells = segment.get(key, [])
    return cells[channel] if channel < len(cells) else otherwise


def read_tdms(data: bytes, label: str) -> Contents:
    """The channels of all groups; their clock is ``wf_start_offset`` and ``wf_increment``.

    It is later by what its ``wf_start_time`` is behind that of the first channel.
    """
    from nptdms import TdmsFile

    # Damaged names would be logged one by one; what is wrong is said once, by whoever called.
    logging.getLogger("nptdms").setLevel(logging.ERROR)
    file = TdmsFile.open(io.BytesIO(data))
    if file.file_status.incomplete_final_segment:
        raise UnfitError.cut_off("a whole .tdms file")
    recorded = [channel for group in file.groups() for channel in group.channels()]
    require_small(sum(8 * len(channel) for channel in recorded), label)
    names = [channel.name for channel in recorded]
    channels: dict[str, Channel] = {}
    begun: Any = None
    for channel in recorded:
        values = np.asarray(channel[:])
        if values.dtype.kind not in "fiu":
            continue
        properties = channel.properties
        clock = even_clock(
            properties.get("wf_increment"), properties.get("wf_start_offset", 0.0), len(values)
        )
        since = properties.get("wf_start_time")
        if isinstance(since, np.datetime64) and clock is not None:
            begun = since if begun is None else begun
            clock = clock + (since - begun) / np.timedelta64(1, "s")
        # The same name in two groups says nothing: such channels need their group's name before theirs.
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        unit = properties.get("unit_string", "")
        channels[name] = Channel(values.astype(np.float64), clock, unit if isinstance(unit, str) else "")
    return Contents(channels)


FORMATS = (
    # Lines that are taken apart one by one take many times their size.
    Format("LabVIEW measurement", SUFFIX, read_lvm, share=0.1),
    Format("NI TDMS", ".tdms", read_tdms),
)
