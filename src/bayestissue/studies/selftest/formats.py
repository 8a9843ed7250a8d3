"""A recording in each format: files in ``samples``, read back in one dataset."""

from __future__ import annotations

import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.studies.selftest.check_results import Compared

SAMPLES = Path(__file__).parent / "samples"
_RATE = 2000.0
# C3D files hold single precision; text has twelve digits.
_SINGLE, _TEXT = 1e-6, 1e-10


def read_back(folder: Path) -> list[Compared]:
    """Read the sample of each format, all of them as one dataset, and compare it with what it holds."""
    from bayestissue.recordings.dataset import read_dataset, write_dataset
    from bayestissue.recordings.dataset.recorders import SUFFIXES

    time = np.arange(200) / _RATE
    value = np.where(time > 0.01, 100 * np.sin(90 * (time - 0.01)) * np.exp(-20 * (time - 0.01)), 0.0)
    endings = [end for end in SUFFIXES if end != ".acq" or find_spec("bioread")]
    names = [f"recording{end}" for end in endings]
    for name in names:
        shutil.copy(SAMPLES / name, folder)
    rows = {"impact": endings, "subject": "s", "trial": "t", "mass_kg": 0.7, "velocity_m_s": 1.5}
    write_dataset(
        folder,
        settings={"name": "formats", "signal": {"quantity": "deceleration", "unit": "m/s^2"}},
        impacts=pd.DataFrame(rows).assign(trace=names),
    )
    data = read_dataset(folder)
    comparisons = []
    for end, trace in zip(endings, data.traces, strict=True):
        same = len(trace.value) == len(value)
        difference = np.abs(np.asarray(trace.value) - value).max() / value.max() if same else np.inf
        clock = np.abs(np.diff(np.asarray(trace.time_s)) - 1 / _RATE).max() * _RATE if same else np.inf
        allowed = _SINGLE if end == ".c3d" else _TEXT
        off = max(difference, clock)
        expected = f"{len(value)} samples, {allowed:g} off at most"
        observed = f"{len(trace.value)} samples, {off:.0e} off"
        comparisons.append(Compared(end, expected, observed, bool(off <= allowed)))
    left_out = [end for end in SUFFIXES if end not in endings]
    return comparisons + [Compared(end, "its library is optional", "not installed", True) for end in left_out]
