"""Files of National Instruments: LabVIEW measurements, ``.lvm``, and ``.tdms``."""

from __future__ import annotations

import io
import logging
import re
from codecs import BOM_UTF8
from typing import Any

import numpy as np

from bayestissue.dataset.files import require_small
from bayestissue.dataset.formats.channel import Channel, Contents, Format, UnfitError, even_clock

SUFFIX = ".lvm"
# As many bytes as show whether a text is LabVIEW's: it begins with its name, and a header has an end.
HEADER = 1 << 14
_MEASUREMENT, _END = b"LabVIEW Measurement", b"***End_of_Header***"


def is_measurement(begin: bytes) -> bool:
    """Whether a file that begins so is a LabVIEW measurement with its header."""
    return begin.removeprefix(BOM_UTF8).startswith(_MEASUREMENT)


def is_headerless(begin: bytes) -> bool:
    """Whether a text that begins so has no header, and is a table then."""
    return bool(begin.strip()) and _END not in begin


def read_lvm(data: bytes, label: str) -> Contents:
    """The channels of the one block of data; their clock is ``X_Value``, else ``X0`` and ``Delta_X``.

    Channels may differ in the number of samples and in their interval: cells behind the end of a short one
    are empty. LabVIEW may have written its one header for the first of many pieces: where ``X_Value`` goes on
    over more rows than the header states, it is the clock of all of them; where it begins again, each piece
    is a block.
    """
    import lvm_read

    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        # LabVIEW writes names and units in the code page of its machine; the numbers are plain.
        text = data.decode("latin-1")
    content: dict[Any, Any] = lvm_read.read_str(_with_decimal_mark(text.removeprefix("\ufeff")))
    if content["Segments"] != 1:
        raise _several(content["Segments"])
    segment = content[0]
    samples, names = segment["data"], segment["Channel names"]
    stated = [int(count) for count in segment.get("Samples", []) if count == count]
    if stated and len(samples) > max(stated):
        if blocks := _begins_again(samples, names):
            raise _several(blocks)
        if "X_Value" in names:
            stated = []
    if stated and max(stated) != len(samples):
        count_words = f"{len(samples)} rows where {max(stated)} are stated"
        raise UnfitError(
            "as many rows as the header's greatest Samples", "Export the recording anew.", count_words
        )
    if unit := set(segment.get("X_Dimension", [])) - {"Time", ""}:
        raise UnfitError("time along X", "Export the signal over time.", ", ".join(sorted(unit)))
    if len(names) > 1 and names[-1] == "Comment":
        names = names[:-1]
    channels: dict[str, Channel] = {}
    x, of_x = None, None
    measured = 0
    for column, name in enumerate(names):
        start, step = _stated(segment, "X0", measured, 0.0), _stated(segment, "Delta_X", measured, None)
        if name == "X_Value":
            x, of_x = samples[:, column], (start, step)
            continue
        count = stated[measured] if measured < len(stated) else len(samples)
        if np.isfinite(samples[count:, column]).any():
            expected = f"empty cells behind the {count} Samples of channel {name}"
            raise UnfitError(expected, "Export the recording anew.", "numbers behind them")
        # One column X_Value is the clock of channels that begin and go on as the one beside it does.
        has_times = x is not None and of_x == (start, step) and np.isfinite(x[:count]).any()
        clock = x[:count] if x is not None and has_times else even_clock(step, start, count)
        unit = _stated(segment, "Y_Unit_Label", measured, "")
        channels[name] = Channel(samples[:count, column], clock, unit if isinstance(unit, str) else "")
        measured += 1
    lines = text.splitlines()
    return Contents(channels, next(i for i, line in enumerate(lines, 2) if line.startswith("X_Value")))


def _with_decimal_mark(text: str) -> str:
    """The text with an entry of its decimal mark, where it has none and numbers have commas."""
    begin = text.find("X_Value")
    header, numbers = text[:begin], text[begin:]
    commas = re.search(r"\d,\d", numbers) and not re.search(r"\d\.\d", numbers)
    if begin < 0 or not commas or re.search(r"^(Decimal_Separator|Separator,)", header, re.MULTILINE):
        return text
    first, end, following = text.partition("\n")
    return f"{first}{end}Decimal_Separator\t,\n{following}"


def _several(blocks: int) -> UnfitError:
    remedy = "Record every impact to a file of its own, and leave no empty line between samples."
    return UnfitError("one block of data", remedy, f"{blocks} blocks")


def _begins_again(samples: np.ndarray, names: list[str]) -> int:
    """How many times ``X_Value`` begins, where that is more than once; else 0."""
    clocks = samples[:, [at for at, name in enumerate(names) if name == "X_Value"]]
    blocks = 1 + int(np.count_nonzero((np.diff(clocks, axis=0) <= 0).any(axis=1)))
    return blocks if blocks > 1 else 0


def _stated(segment: dict[str, Any], key: str, channel: int, otherwise: Any) -> Any:
    cells = segment.get(key, [])
    return cells[channel] if channel < len(cells) else otherwise


def read_tdms(data: bytes, label: str) -> Contents:
    """The channels of all groups; their clock is ``wf_start_offset`` and ``wf_increment``."""
    from nptdms import TdmsFile

    # Damaged names would be logged one by one; what is wrong is said once, by whoever called.
    logging.getLogger("nptdms").setLevel(logging.ERROR)
    file = TdmsFile.open(io.BytesIO(data))
    if file.file_status.incomplete_final_segment:
        raise UnfitError("a whole .tdms file", "Copy or export the recording anew.", "an end that is missing")
    recorded = [channel for group in file.groups() for channel in group.channels()]
    require_small(sum(8 * len(channel) for channel in recorded), label)
    names = [channel.name for channel in recorded]
    channels: dict[str, Channel] = {}
    for channel in recorded:
        values = np.asarray(channel[:])
        if values.dtype.kind not in "fiu":
            continue
        properties = channel.properties
        clock = even_clock(
            properties.get("wf_increment"), properties.get("wf_start_offset", 0.0), len(values)
        )
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
