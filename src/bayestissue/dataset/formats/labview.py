"""Files of National Instruments: LabVIEW measurements, ``.lvm``, and ``.tdms``."""

from __future__ import annotations

import io
import logging
from typing import Any

import numpy as np

from bayestissue.dataset.files import require_small
from bayestissue.dataset.formats.channel import Channel, Contents, Format, UnfitError, even_clock


def read_lvm(data: bytes, label: str) -> Contents:
    """The channels of the one block of data; their clock is ``X_Value``, else ``X0`` and ``Delta_X``.

    Channels may differ in the number of samples and in their interval: cells behind the end of a short one
    are empty.
    """
    import lvm_read

    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        # LabVIEW writes names and units in the code page of its machine; the numbers are plain.
        text = data.decode("latin-1")
    content: dict[Any, Any] = lvm_read.read_str(text)
    if content["Segments"] != 1:
        raise UnfitError(
            "one block of data",
            "Record every impact to a file of its own, and leave no empty line between samples.",
            f"{content['Segments']} blocks",
        )
    segment = content[0]
    samples, names = segment["data"], segment["Channel names"]
    stated = [int(count) for count in segment.get("Samples", []) if count == count]
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
    Format("LabVIEW measurement", ".lvm", read_lvm, share=0.1),
    Format("NI TDMS", ".tdms", read_tdms),
)
