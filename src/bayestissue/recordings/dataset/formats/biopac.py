"""Biopac's AcqKnowledge files, ``.acq``, by the library bioread, which is installed on demand."""

from __future__ import annotations

import io
import logging

import numpy as np

from bayestissue.recordings.dataset.formats.channel import (
    CUT_OFF,
    Channel,
    Contents,
    UnfitError,
    clock_of,
    unique,
)
from bayestissue.recordings.dataset.source_files import require_small


def read(data: bytes, label: str) -> Contents:
    """The channels by name; their clock begins at 0 s and runs at each channel's own rate.

    Raises:
        UnfitError: bioread is not installed, or the file's end is missing.
        Exception: the file is damaged: whatever bioread raises.
    """
    try:
        from bioread.reader import Reader
    except ImportError:
        raise UnfitError("recorder-file.library", "none installed") from None
    # What is wrong is said once, by whoever called.
    logging.getLogger("bioread").setLevel(logging.CRITICAL)
    headers = Reader.read_headers(io.BytesIO(data))
    if headers.datafile is None or headers.data_length is None:
        raise ValueError("no AcqKnowledge file, or one whose header is damaged")
    if not headers.is_compressed and headers.data_start_offset + headers.data_length > len(data):
        raise UnfitError("recorder-file.cut-off", CUT_OFF, expected="all samples that its header states")
    require_small(8.0 * sum(channel.point_count for channel in headers.datafile.channels), label)
    recorded = Reader.read(io.BytesIO(data)).datafile.channels
    names = unique((channel.name.strip() for channel in recorded), "channel")
    channels = {}
    for name, channel in zip(names, recorded, strict=True):
        values, rate = np.asarray(channel.data, dtype=np.float64), float(channel.samples_per_second)
        channels[name] = Channel(values, clock_of(rate, values.size), channel.units.strip())
    return Contents(channels)
