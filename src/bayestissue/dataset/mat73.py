"""The numeric variables of a MATLAB 7.3 file."""

from __future__ import annotations

import io

import numpy as np

from bayestissue.dataset.files import require_small


def numeric_variables(data: bytes, label: str) -> dict[str, np.ndarray]:
    """The numeric arrays of a MATLAB 7.3 file, which is an HDF5 file, by name.

    Args:
        data: the whole file.
        label: what to call it in a message.

    Raises:
        InputError: its variables are too large once they are unpacked.
        OSError: the file is damaged.
    """
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        # Links and external storage would lead to other files.
        own = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
        items = {name: file[name] for name in own}
        items = {
            name: item
            for name, item in items.items()
            if isinstance(item, h5py.Dataset)
            and item.attrs.get("MATLAB_class", b"double") != b"char"
            and not (item.external or item.is_virtual)
        }
        require_small(sum(item.nbytes for item in items.values()), label)
        return {name: np.asarray(item) for name, item in items.items()}
