from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_array

from bayestissue.recordings.dataset.formats import mat


def numeric_variables(data: bytes) -> dict[str, np.ndarray]:
    return {name: channel.values for name, channel in mat.read(data, "a.mat").channels.items()}


def packed(variables: dict[str, object], *, compress: bool = False) -> bytes:
    buffer = io.BytesIO()
    savemat(buffer, variables, do_compression=compress)
    return buffer.getvalue()


@pytest.mark.parametrize("compress", [False, True])
def test_numbers_among_other_things(compress: bool) -> None:
    data = packed(
        {
            "value": np.linspace(0, 1, 7),
            "counts": np.arange(5, dtype=np.int16)[:, None],
            "who": "somebody",
            "settings": {"rate": 1e4, "names": np.array(["a", 1.0], dtype=object)},
            "sparse": csc_array(np.eye(3)),
            "spectrum": np.array([1j, 2.0]),
        },
        compress=compress,
    )
    found = numeric_variables(data)
    assert set(found) == {"value", "counts", "settings.rate"}
    np.testing.assert_array_equal(found["value"], np.linspace(0, 1, 7))
    np.testing.assert_array_equal(found["counts"], np.arange(5))


def _with_size(data: bytes, size: int) -> bytes:
    return data[:132] + struct.pack("<I", size) + data[136:]


@pytest.mark.parametrize("size", [0, 8, 40, 100, 2**31, 2**32 - 1])
def test_a_size_that_can_not_be_right(size: int) -> None:
    with pytest.raises((ValueError, struct.error)):
        numeric_variables(_with_size(packed({"value": np.arange(9.0)}), size))


def test_a_shape_that_the_values_do_not_fill() -> None:
    data = packed({"value": np.arange(9.0)})
    shape = struct.pack("<ii", 1, 9)
    assert data.count(shape) == 1
    with pytest.raises(ValueError, match="cannot reshape"):
        numeric_variables(data.replace(shape, struct.pack("<ii", 1, 9000)))


def test_a_damaged_packed_variable() -> None:
    data = packed({"value": np.arange(9.0)}, compress=True)
    with pytest.raises(zlib.error):
        numeric_variables(data[:150] + b"\x00\x00" + data[152:])


def test_an_older_file_is_refused() -> None:
    with pytest.raises(ValueError, match="neither"):
        numeric_variables(b"\x00" * 200)
