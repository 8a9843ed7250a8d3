"""Biopac's AcqKnowledge files, ``.acq``, by the library bioread, which is installed on demand."""

from __future__ import annotations

import io
import logging
from typing import Any

import numpy as np

from bayestissue.dataset.files import require_small, unpacked_size
from bayestissue.dataset.formats.channel import Channel, Contents, Format, UnfitError, clock_of, unique


def read(data: bytes, label: str, most_channels: int = 500) -> Contents:
    """The channels by name; their clock begins at 0 s and runs at each channel's own rate.

    Raises:
        UnfitError: bioread is not installed.
        Exception: the file is damaged: whatever bioread raises.
    """
    try:
        from bioread.header_reader import GraphHeaderReader
        from bioread.headers import ChannelHeader
        from bioread.reader import Reader
    except ImportError:
        raise UnfitError(
            "the library bioread, which reads Biopac files",
            'Install it: pip install "bayestissue[biopac]".',
            "none installed",
        ) from None
    # What is wrong is said once, by whoever called.
    logging.getLogger("bioread").setLevel(logging.CRITICAL)
    graph = GraphHeaderReader.bootstrap(io.BytesIO(data))
    header_size = ChannelHeader.for_revision(graph.file_revision, graph.byte_order_char).struct_length
    # Where it can't find their types, bioread looks for all channels at 4,096 places.
    if graph.channel_count > min(len(data) / header_size, most_channels):
        raise ValueError(f"a header that states {graph.channel_count} channels")
    headers = Reader.read_headers(io.BytesIO(data))
    if headers.datafile is None or headers.data_length is None:
        raise ValueError("no AcqKnowledge file, or one whose header is damaged")
    if headers.is_compressed:
        size = 0
        for header in headers.channel_compression_headers:
            begin = header.compressed_data_offset
            size = unpacked_size(data[begin : begin + header.compressed_data_len], label, before=size)
    elif headers.data_start_offset + headers.data_length > len(data):
        raise UnfitError.cut_off("all samples that its header states")
    require_small(sum(8.0 * channel.point_count for channel in headers.datafile.channels), label)
    recorded = Reader.read(io.BytesIO(data)).datafile.channels
    names = unique((channel.name.strip() for channel in recorded), "channel")
    return Contents(dict(zip(names, map(_channel, recorded), strict=True)))


def _channel(channel: Any) -> Channel:
    values, rate = np.asarray(channel.data, dtype=np.float64), float(channel.samples_per_second)
    return Channel(values, clock_of(rate, values.size), channel.units.strip())


FORMAT = Format("Biopac AcqKnowledge", ".acq", read)
