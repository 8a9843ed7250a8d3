"""Worker processes: what they hold of their work is no leak."""

from __future__ import annotations

import os
import time
import warnings

import pytest

from bayestissue.base import runtime

pytestmark = pytest.mark.slow

_held: list[bytearray] = []


def grown(megabytes: int) -> int:
    """Hold so much more memory, as compiled programs do, and say which process this is."""
    _held.append(bytearray(os.urandom(2**20) * megabytes))
    # So long after its last look loky looks at a worker's memory again.
    time.sleep(1.2)
    return os.getpid()


def test_a_worker_whose_work_takes_memory_goes_on() -> None:
    with warnings.catch_warnings(record=True) as warned, runtime.worker_pool(1) as pool:
        warnings.simplefilter("always")
        futures = [pool.submit(grown, megabytes) for megabytes in (400, 1, 1)]
        processes = {future.result() for future in futures}
    assert len(processes) == 1
    assert not [str(each.message) for each in warned if "worker" in str(each.message)]
