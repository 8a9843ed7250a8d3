"""MATLAB's ``.mat`` files, versions 5 to 7.3: every numeric vector is a channel."""

from __future__ import annotations

import numpy as np

from bayestissue.dataset.formats import hdf5, mat5
from bayestissue.dataset.formats.channel import Channel, Contents, Format


def read(data: bytes, label: str) -> Contents:
    """The vectors by name; such files carry no clock and no units."""
    if data[512:520] == hdf5.SIGNATURE or data[:8] == hdf5.SIGNATURE:
        content = hdf5.variables(data, label)
    else:
        content = mat5.numeric_variables(data, label)
    return Contents(
        {
            name: Channel(np.ravel(values).astype(np.float64))
            for name, values in content.items()
            if isinstance(values, np.ndarray)
            and values.dtype.kind in "fiu"
            and max(values.shape, default=0) == values.size
        }
    )


FORMAT = Format("MATLAB", ".mat", read)
