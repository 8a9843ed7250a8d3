"""National Instruments' ``.tdms`` files."""

from __future__ import annotations

import io
import logging

import numpy as np

from bayestissue.dataset.files import require_small
from bayestissue.dataset.formats.channel import Channel, Contents, Format, UnfitError, even_clock


def read(data: bytes, label: str) -> Contents:
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


FORMAT = Format("NI TDMS", ".tdms", read)
