"""Biopac's AcqKnowledge files, ``.acq``, by the library bioread, which is installed on demand."""

from __future__ import annotations

import io
import logging

import numpy as np

from bayestissue.dataset.files import require_small
from bayestissue.dataset.formats.channel import Channel, Contents, Format, UnfitError, even_clock


def read(data: bytes, label: str) -> Contents:
    """The channels by name; their clock begins at 0 s and runs at each channel's own rate.

    Raises:
        UnfitError: bioread is not installed.
        Exception: the file is damaged: whatever bioread raises.
    """
    try:
        import bioread
    except ImportError:
        raise UnfitError(
            "the library bioread, which reads Biopac files",
            'Install it: pip install "bayestissue[biopac]".',
            "none installed",
        ) from None
    # What is wrong is said once, by whoever called.
    logging.getLogger("bioread").setLevel(logging.CRITICAL)
    about = bioread.read_headers(io.BytesIO(data))
    if about is None:
        raise ValueError("no AcqKnowledge file, or one whose header is damaged")
    require_small(sum(8.0 * channel.point_count for channel in about.channels), label)
    channels: dict[str, Channel] = {}
    for number, channel in enumerate(bioread.read(io.BytesIO(data)).channels, 1):
        values = np.asarray(channel.data, dtype=np.float64)
        name = channel.name.strip() or f"channel {number}"
        name = name if name not in channels else f"{name} {number}"
        rate = float(channel.samples_per_second)
        clock = even_clock(1 / rate, 0.0, values.size) if rate > 0 else None
        channels[name] = Channel(values, clock, channel.units.strip())
    return Contents(channels)


FORMAT = Format("Biopac AcqKnowledge", ".acq", read)
