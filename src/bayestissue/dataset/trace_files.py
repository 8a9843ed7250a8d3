"""One recorder file per impact, as `impacts.csv` names them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.dataset.crop import COLUMNS, Windows
from bayestissue.dataset.files import require_small
from bayestissue.dataset.recorders import REMEDY, Recording, read_recording
from bayestissue.dataset.recordings import Reading, Samples, in_seconds, in_si
from bayestissue.dataset.settings import SignalSettings
from bayestissue.errors import InputError, Problem, refusal


def read_files(folder: Path, impacts: pd.DataFrame, rows: np.ndarray, signal: SignalSettings) -> Reading:
    """Read one recorder file per impact, as the column ``trace`` names them.

    Args:
        folder: the dataset's.
        impacts: with the columns ``impact``, ``trace`` and perhaps ``sampling_rate_hz``.
        rows: for every impact its row in ``impacts.csv``.
        signal: names of the channels, units, scale and offset.
    """
    problems: list[Problem] = []
    pieces, files, positions = [], [], []
    rates = impacts.get("sampling_rate_hz", pd.Series(np.nan, index=impacts.index)).to_numpy()
    windows = Windows.stated(impacts, signal)
    taken: dict[Path, list[int]] = {}
    held: tuple[Path, Recording] | None = None
    size = 0
    for index, (impact, name) in enumerate(zip(impacts["impact"], impacts["trace"], strict=True)):
        try:
            path = _inside(folder, name, int(rows[index]))
            _require_apart(path, name, index, int(rows[index]), taken, windows)
            # One that several impacts share is read once: they mostly follow each other.
            if held is None or held[0] != path:
                held = (path, read_recording(path, name, signal))
            time = _time(held[1], rates[index], name, signal)
        except InputError as error:
            of_impact = partial(replace, impact=impact or None, files_read=len(impacts))
            problems += map(of_impact, error.problems)
            continue
        taken.setdefault(path, []).append(index)
        piece = _Piece.inside(held[1], time, windows.inside(index, time))
        if not piece.time.size and time.size:
            problems.append(windows.nothing(index, time, name, impact))
            continue
        size += piece.time.nbytes + piece.value.nbytes
        require_small(size, "the recordings together")
        pieces.append(piece)
        files.append(name)
        positions.append(index)
    count = np.array([piece.value.size for piece in pieces], dtype=int)
    start = np.concatenate([[0], np.cumsum(count)]).astype(int)
    samples = Samples(
        np.concatenate([np.empty(0), *(piece.time for piece in pieces)]),
        in_si(np.concatenate([np.empty(0), *(piece.value for piece in pieces)]), signal),
        start,
        np.array(positions, dtype=int),
        files,
        np.concatenate([np.empty(0, int), *(piece.row for piece in pieces)]),
        signal.time_column,
        signal.value_column,
        {
            int(begin) + at: text
            for begin, piece in zip(start, pieces, strict=False)
            for at, text in piece.text.items()
        },
    )
    return Reading(samples, problems, list(taken))


def read_one(
    path: Path, label: str, signal: SignalSettings, rate: float = np.nan
) -> tuple[np.ndarray, np.ndarray]:
    """The times (s) and values (m/s² or m) of a whole recording, both [sample].

    Args:
        path: the file.
        label: what to call it in a message.
        signal: names of the channels, units, scale and offset.
        rate: the sampling rate in Hz, where the file has no times.

    Raises:
        InputError: the file is missing or damaged, lacks a channel, or has no times.
    """
    recording = read_recording(path, label, signal)
    return _time(recording, rate, label, signal), in_si(recording.value, signal)


@dataclass(frozen=True, eq=False)
class _Piece:
    """The samples of one impact: all of a recording, or the stretch to which it is cropped."""

    time: np.ndarray
    value: np.ndarray
    row: np.ndarray
    text: dict[int, str]

    @classmethod
    def inside(cls, recording: Recording, time: np.ndarray, inside: np.ndarray | slice) -> _Piece:
        row = recording.first_row + np.arange(recording.value.size)
        text = recording.text or {}
        if isinstance(inside, np.ndarray):
            position = np.cumsum(inside) - 1
            text = {int(position[at]): words for at, words in text.items() if inside[at]}
        return cls(time[inside], recording.value[inside], row[inside], text)


def _require_apart(
    path: Path, name: str, index: int, row: int, taken: dict[Path, list[int]], windows: Windows
) -> None:
    """Refuse a recording, or a part of one, that an earlier impact has."""
    if any(windows.meet(index, neighbour) for neighbour in taken.get(path, ())):
        cropped = np.isfinite(windows.start[index]) or np.isfinite(windows.stop[index])
        raise refusal(
            "impacts.csv",
            f"a recording of its own for every impact, or a part of one between {' and '.join(COLUMNS)}",
            "Correct one of the two rows.",
            row,
            "trace",
            (f"{name}, from {windows.start[index]:.6g} to {windows.stop[index]:.6g} s" if cropped else name),
            code="impacts-and-recordings",
        )


def _inside(folder: Path, name: str, row: int) -> Path:
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
    if expected:
        raise refusal(
            "impacts.csv", expected, remedy, row, "trace", name or "an empty cell", code="which-recordings"
        )
    return path


def _time(recording: Recording, rate: float, file: str, signal: SignalSettings) -> np.ndarray:
    if recording.time is not None:
        return in_seconds(recording.time, signal)
    if recording.clock is not None:
        return recording.clock
    if np.isfinite(rate):
        return np.arange(recording.value.size) / rate
    raise refusal(
        file,
        f"a time column {signal.time_column!r}, or the impact's sampling_rate_hz in impacts.csv",
        "Name the time column as signal.time_column in dataset.toml, or state the sampling rate.",
        column=signal.time_column,
        value="no times",
        code="no-times",
    )
