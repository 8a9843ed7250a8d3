"""Files of National Instruments: LabVIEW measurements, ``.lvm``, and ``.tdms``."""

from __future__ import annotations

import io
import logging
import re
from codecs import BOM_UTF8
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import chain, pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float64

from bayestissue.recordings.dataset import clock_times
from bayestissue.recordings.dataset.formats.channel import CUT_OFF, Channel, Contents, UnfitError, even_clock
from bayestissue.recordings.dataset.ragged_traces import PerSample
from bayestissue.recordings.dataset.source_files import require_small

SUFFIX = ".lvm"
# As many bytes as show whether a text is LabVIEW's: it begins with its name, and a header has an end.
HEADER = 1 << 14
_MEASUREMENT, _END, _CHANNELS = "LabVIEW Measurement", b"***End_of_Header***", "Channels"
# Lines between the pieces of a block.
_EMPTY = ("", "\t", ",", ";")


def is_measurement(begin: bytes, *, named: bool) -> bool:
    """Whether a file that begins so is a LabVIEW measurement; of that name one without a header is none."""
    begins = begin.removeprefix(BOM_UTF8).startswith(_MEASUREMENT.encode())
    return begins or (named and (_END in begin or not begin.strip()))


def read_lvm(data: bytes, label: str) -> Contents:
    """The blocks of a file, and the channels of one of a single block.

    A block of data has a header of its own, or it has as many rows as the header before it states, behind an
    empty line or where ``X_Value`` begins again. Blocks of which each begins one sampling interval after the
    end of the one before are one recording: LabVIEW writes a long one in segments. The clock of a channel is
    ``X_Value``, else ``X0`` and ``Delta_X``, and later by what its ``Time`` is behind that of the first
    channel. Channels may differ in the number of samples and in their
    interval: cells behind the end of a short one are empty.
    """
    recordings = _recordings(data)
    only = recordings[0] if len(recordings) == 1 else Contents({})
    return replace(only, blocks=recordings)


# The blocks of a file are asked for one by one, each time with the whole of it.
@lru_cache(maxsize=1)
def _recordings(data: bytes) -> tuple[Contents, ...]:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        # LabVIEW writes names and units in the code page of its machine; the numbers are plain.
        text = data.decode("latin-1")
    recordings: list[list[Contents]] = []
    for block in _blocks(text.removeprefix("\ufeff")):
        for piece in block.contents():
            if not recordings or not _goes_on(recordings[-1][-1], piece):
                recordings.append([])
            recordings[-1].append(piece)
    return tuple(map(_joined, recordings))


def _blocks(text: str) -> list[_Block]:
    """Every block of data, with the headers that hold for it.

    Raises:
        UnfitError: there are no numbers below a header, as where a file was cut short.
    """
    blocks: list[_Block] = []
    for row, line in enumerate(text.replace("\r", "").split("\n"), 1):
        if line.startswith(_MEASUREMENT):
            blocks.append(_Block({}))
        elif blocks and blocks[-1].stated and line.split(blocks[-1].separator)[0] == _CHANNELS:
            lines = blocks[-1].pieces[-1][1] if blocks[-1].pieces else []
            # Lines of words above the next header.
            while lines and lines[-1][:1].isalpha():
                lines.pop()
            blocks.append(_Block(blocks[-1].header, blocks[-1].separator))
        if blocks:
            blocks[-1].take(line, row)
    for block in blocks:
        block.pieces = [piece for piece in block.pieces if piece[1]]
        if not block.pieces:
            where = f"none below the header that ends in row {block.row}"
            raise UnfitError("recorder-file.cut-off", where, expected="numbers below every header")
    return blocks


@dataclass
class _Block:
    """A block of data.

    Attributes:
        header: what the file's own says.
        separator: between cells.
        stated: what the block's says: of each key the cells, one a channel.
        names: of the columns.
        pieces: the lines of numbers between empty ones, each with the row of the first.
        row: of the last line.
    """

    header: dict[str, str]
    separator: str = "\t"
    stated: dict[str, list[str]] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    pieces: list[tuple[int, list[str]]] = field(default_factory=list)
    row: int = 1

    def take(self, line: str, row: int) -> None:
        """The next line, in a row of the file."""
        self.row = row
        if self.names:
            if line in _EMPTY:
                self.pieces.append((row + 1, []))
            else:
                self.pieces[-1][1].append(line)
            return
        if line.startswith("Separator") and not self.stated:
            self.separator = line.strip()[len("Separator")]
        key, *cells = line.split(self.separator)
        if key == "X_Value" and self.stated:
            self.names, self.pieces = line.split(self.separator)[self.columns], [(row + 1, [])]
        elif self.stated or key == _CHANNELS:
            self.stated[key] = cells
        elif len(cells) == 1:
            self.header[key] = cells[0]

    @property
    def columns(self) -> slice:
        """Which cells of a line are of channels."""
        stated = self.stated[_CHANNELS]
        return slice(self.header.get("X_Columns") == "No", max(len(stated), int(stated[0])) + 1)

    def number(self, key: str, channel: int, otherwise: float | None = None) -> float | None:
        """What the header states of a channel; ``otherwise`` where it says nothing."""
        cell = self.text(key, channel)
        return float(cell.replace(self.decimal, ".")) if cell else otherwise

    def text(self, key: str, channel: int) -> str:
        """What the header states of a channel, as it stands there."""
        cells = self.stated.get(key, [])
        return cells[channel] if channel < len(cells) else ""

    @cached_property
    def decimal(self) -> str:
        """The decimal mark: as the file states it, else a comma where numbers have no other."""
        if self.separator == "," or "Decimal_Separator" in self.header:
            return self.header.get("Decimal_Separator") or "."
        text = "\n".join(chain.from_iterable(lines for _, lines in self.pieces))
        return "," if re.search(r"\d,\d", text) and not re.search(r"\d\.\d", text) else "."

    def samples(self, lines: Sequence[str]) -> Float64[np.ndarray, "row column"]:
        """The cells of lines as numbers, nan where one holds none or is missing."""
        rows = [line.replace(self.decimal, ".").split(self.separator)[self.columns] for line in lines]
        width = len(self.names)
        return np.array([[*map(_number, cells[:width]), *[np.nan] * (width - len(cells))] for cells in rows])

    def contents(self) -> Iterator[Contents]:
        """The channels of each piece, and of each piece of one whose ``X_Value`` begins again."""
        if unit := {*self.stated.get("X_Dimension", [])} - {"Time", ""}:
            raise UnfitError("recorder-file.spectrum", ", ".join(sorted(unit)))
        stated = [int(float(cell)) for cell in self.stated.get("Samples", []) if cell]
        greatest, has_times = max(stated, default=0), "X_Value" in self.names
        for first_row, lines in self.pieces:
            if first_row != self.pieces[0][0] and not has_times:
                raise UnfitError("recorder-file.pieces", f"neither of the one from row {first_row} on")
            samples = self.samples(lines)
            clocks = samples[:, [name == "X_Value" for name in self.names]]
            again = np.flatnonzero((np.diff(clocks, axis=0) <= 0).any(axis=1)) + 1
            begins = again.tolist() if len(samples) > greatest > 0 else []
            for first, last in pairwise([0, *begins, len(samples)]):
                rows = last - first
                # The one header may be that of the first of many pieces, over all of which X_Value goes on.
                several = rows > greatest > 0 and has_times
                if stated and rows != greatest and (not several or (begins and rows % greatest)):
                    expected = "as many rows as the header's greatest Samples"
                    value = f"{rows} rows where {greatest} are stated"
                    raise UnfitError("recorder-file.cut-off", value, expected=expected)
                yield self._channels(samples[first:last], [] if several else stated, first_row + first)

    def _channels(
        self, samples: Float64[np.ndarray, "row column"], stated: list[int], first_row: int
    ) -> Contents:
        """The channels of rows of numbers; ``stated`` is how many samples each has, if its header says so."""
        channels: dict[str, Channel] = {}
        x, of_x = None, None
        measured = 0
        for column, name in enumerate(self.names):
            if name == "Comment" and 0 < column == len(self.names) - 1:
                break
            start, step = self.number("X0", measured, 0.0), self.number("Delta_X", measured)
            late = self._behind_first(measured, start)
            if name == "X_Value":
                x, of_x = samples[:, column], (start, step, late)
                continue
            count = stated[measured] if measured < len(stated) else len(samples)
            if np.isfinite(samples[count:, column]).any():
                expected = f"empty cells behind the {count} Samples of channel {name}"
                raise UnfitError("recorder-file.cut-off", "numbers behind them", expected=expected)
            # One column X_Value is the clock of channels that begin and go on as the one beside it does.
            has_times = x is not None and of_x == (start, step, late) and np.isfinite(x[:count]).any()
            clock = x[:count] if x is not None and has_times else even_clock(step, start, count)
            clock = clock + late if clock is not None and late else clock
            channels[name] = Channel(samples[:count, column], clock, self.text("Y_Unit_Label", measured))
            measured += 1
        return Contents(channels, first_row)

    def _behind_first(self, channel: int, start: float | None) -> float:
        """By what a channel's ``Time`` is behind the first one's, s; 0 where X counts from a day long ago."""
        times = clock_times.seconds(pa.array([self.text("Time", number) for number in (0, channel)]))
        if times is None or start is None or start > clock_times.DAY_S or not np.isfinite(times[0]).all():
            return 0.0
        return clock_times.within_a_day(float(times[0][1]))


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _goes_on(before: Contents, after: Contents) -> bool:
    """Whether every channel begins one sampling interval after the end of that of the block before."""
    units = [{name: c.unit for name, c in piece.channels.items()} for piece in (before, after)]
    pairs = zip(before.channels.values(), after.channels.values(), strict=False)
    return units[0] == units[1] and all(_follows(first.clock, second.clock) for first, second in pairs)


def _follows(before: PerSample | None, after: PerSample | None) -> bool:
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
    channels = {
        name: Channel.joined([replace(piece.channels[name], rows=piece.rows_of(name)) for piece in pieces])
        for name in pieces[0].channels
    }
    return Contents(channels, pieces[0].first_row)


def read_tdms(data: bytes, label: str) -> Contents:
    """The channels of all groups; their clock is ``wf_start_offset`` and ``wf_increment``.

    It is later by what its ``wf_start_time`` is behind that of the first channel.
    """
    from nptdms import TdmsFile

    # Damaged names would be logged one by one; what is wrong is said once, by whoever called.
    logging.getLogger("nptdms").setLevel(logging.ERROR)
    file = TdmsFile.open(io.BytesIO(data))
    if file.file_status.incomplete_final_segment:
        raise UnfitError("recorder-file.cut-off", CUT_OFF, expected="a whole .tdms file")
    recorded = [channel for group in file.groups() for channel in group.channels()]
    require_small(sum(8 * len(channel) for channel in recorded), label)
    names = [channel.name for channel in recorded]
    channels: dict[str, Channel] = {}
    origin: Any = None
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
            origin = since if origin is None else origin
            clock = clock + (since - origin) / np.timedelta64(1, "s")
        # The same name in two groups says nothing: such channels need their group's name before theirs.
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        unit = properties.get("unit_string", "")
        channels[name] = Channel(values.astype(np.float64), clock, unit if isinstance(unit, str) else "")
    return Contents(channels)
