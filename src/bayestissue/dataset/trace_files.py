"""One recorder file per impact, as `impacts.csv` names them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.dataset.files import require_small
from bayestissue.dataset.recorders import REMEDY, Recording, read_recording
from bayestissue.dataset.samples import Reading, Samples, in_seconds, in_si
from bayestissue.dataset.settings import SignalSettings
from bayestissue.errors import InputError, Problem


def read_files(folder: Path, impacts: pd.DataFrame, rows: np.ndarray, signal: SignalSettings) -> Reading:
    """Read one recorder file per impact, as the column ``trace`` names them.

    Args:
        folder: the dataset's.
        impacts: with the columns ``impact``, ``trace`` and perhaps ``sampling_rate_hz``.
        rows: for every impact its row in ``impacts.csv``.
        signal: names of the channels, units, scale and offset.
    """
    problems, recordings, files, kept = [], [], [], []
    rates = impacts.get("sampling_rate_hz", pd.Series(np.nan, index=impacts.index)).to_numpy()
    taken: dict[Path, str] = {}
    size = 0
    for index, (impact, name) in enumerate(zip(impacts["impact"], impacts["trace"], strict=True)):
        try:
            path = _inside(folder, name, int(rows[index]), taken)
            recording = read_recording(path, name, signal)
            time = _time(recording, rates[index], name, signal)
        except InputError as error:
            problems += [replace(problem, impact=impact or None) for problem in error.problems]
            continue
        size += time.nbytes + recording.value.nbytes
        require_small(size, "the recordings together")
        taken[path] = name
        recordings.append((time, recording))
        files.append(name)
        kept.append(index)
    count = np.array([recording.value.size for _, recording in recordings], dtype=int)
    start = np.concatenate([[0], np.cumsum(count)]).astype(int)
    samples = Samples(
        np.concatenate([np.empty(0), *(time for time, _ in recordings)]),
        in_si(np.concatenate([np.empty(0), *(r.value for _, r in recordings)]), signal),
        start,
        np.array(kept, dtype=int),
        files,
        np.concatenate([np.empty(0, int), *(r.first_row + np.arange(r.value.size) for _, r in recordings)]),
        signal.time_column,
        signal.value_column,
        {
            begin + i: text
            for begin, (_, r) in zip(start, recordings, strict=False)
            for i, text in (r.text or {}).items()
        },
    )
    return Reading(samples, problems, list(taken))


def _inside(folder: Path, name: str, row: int, taken: dict[Path, str]) -> Path:
    expected, remedy = "", REMEDY
    path = Path(name)
    try:
        path = (folder / name).resolve()
        outside = Path(name).is_absolute() or not path.is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):
        outside = True
    if not name:
        expected = "the file with this impact's recording"
    elif outside:
        expected = "a path inside the dataset's folder"
        remedy = "Put the recording into the folder and name it relative to dataset.toml."
    elif path in taken:
        expected, remedy = "a recording of its own for every impact", "Correct one of the two rows."
    if expected:
        raise InputError(Problem("impacts.csv", expected, remedy, row, "trace", name or "an empty cell"))
    return path


def _time(recording: Recording, rate: float, file: str, signal: SignalSettings) -> np.ndarray:
    if recording.time is not None:
        return in_seconds(recording.time, signal)
    if recording.clock is not None:
        return recording.clock
    if np.isfinite(rate):
        return np.arange(recording.value.size) / rate
    raise InputError(
        Problem(
            file,
            f"a time column {signal.time_column!r}, or the impact's sampling_rate_hz in impacts.csv",
            "Name the time column as signal.time_column in dataset.toml, or state the sampling rate.",
            column=signal.time_column,
            value="no times",
        )
    )
