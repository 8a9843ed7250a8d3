"""All recordings of a dataset end to end in one array, so that checks and conversions need no loop."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int

from bayestissue.dataset.recorders import REMEDY, Recording, read_recording
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import Labels, read_table
from bayestissue.dataset.units import to_si
from bayestissue.errors import InputError, Problem

LONG_TABLES = ("traces.csv", "traces.csv.gz", "traces.parquet")


@dataclass(frozen=True, eq=False)
class Samples:
    """The recordings of all impacts that have one, end to end, in SI units.

    Attributes:
        time: s.
        value: m/s² or m, after scale and offset; nan where the file held no number.
        start: where each impact's samples begin, and last where they all end.
        impact: for each of them its position in ``impacts.csv``.
        file: for each of them the file it came from.
        row: for every sample its row there.
        time_column, value_column: what the columns are called there.
        text: what stood in cells that held no number, by the index of the sample.
    """

    time: Float64[np.ndarray, " sample"]
    value: Float64[np.ndarray, " sample"]
    start: Int[np.ndarray, " impact+1"]
    impact: Int[np.ndarray, " impact"]
    file: list[str]
    row: Int[np.ndarray, " sample"]
    time_column: str = "time_s"
    value_column: str = "value"
    text: dict[int, str] = field(default_factory=dict)

    @property
    def count(self) -> np.ndarray:
        """How many samples each impact has."""
        return np.diff(self.start)

    @property
    def owner(self) -> np.ndarray:
        """For every sample which of the recordings it belongs to."""
        return np.repeat(np.arange(self.impact.size), self.count)

    def only(self, keep: np.ndarray) -> Samples:
        """The recordings for which ``keep`` (one truth value each) holds."""
        if keep.all():
            return self
        mask = np.repeat(keep, self.count)
        return Samples(
            self.time[mask],
            self.value[mask],
            np.concatenate([[0], np.cumsum(self.count[keep])]),
            self.impact[keep],
            [file for file, kept in zip(self.file, keep, strict=True) if kept],
            self.row[mask],
            self.time_column,
            self.value_column,
        )


@dataclass(frozen=True, eq=False)
class Reading:
    """What came of reading the recordings.

    Attributes:
        samples: of the impacts that have any.
        problems: what is wrong with single impacts.
        files: what was read.
    """

    samples: Samples
    problems: list[Problem]
    files: list[Path]


def find_long(folder: Path) -> list[Path]:
    """The trace tables in a dataset's folder; there should be one."""
    return [folder / name for name in LONG_TABLES if (folder / name).exists()]


def read_long(folder: Path, impacts: list[str], signal: SignalSettings) -> Reading:
    """Read the one long table of all samples.

    Args:
        folder: the dataset's.
        impacts: the names in ``impacts.csv``, in order.
        signal: names of the columns, units, scale and offset.

    Raises:
        InputError: there is no such table, or more than one, or it can't be read.
    """
    path = _the_one(folder)
    columns, labels = read_table(
        path,
        path.name,
        numbers=[signal.time_column, signal.value_column],
        labels=["impact"],
        remedy="Put the file there.",
    )
    times, readings = columns[signal.time_column], columns[signal.value_column]
    place = {name: index for index, name in reversed(list(enumerate(impacts)))}
    codes = np.array([place.get(name, -1) for name in labels["impact"].names])[labels["impact"].codes]
    order = _order(codes)
    count = np.bincount(codes[codes >= 0], minlength=len(impacts))
    has = np.flatnonzero(count)
    samples = Samples(
        _in_seconds(times.array[order], signal),
        _converted(readings.array[order], signal),
        np.concatenate([[0], np.cumsum(count[has])]),
        has,
        [path.name] * has.size,
        np.arange(2, codes.size + 2)[order],
        signal.time_column,
        signal.value_column,
        _moved({**times.text, **readings.text}, order, codes.size),
    )
    return Reading(
        samples,
        _strangers(path.name, labels["impact"], codes) + _absent(path.name, impacts, place, count),
        [path],
    )


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
    for index, (impact, name) in enumerate(zip(impacts["impact"], impacts["trace"], strict=True)):
        try:
            path = _inside(folder, name, int(rows[index]), taken)
            recording = read_recording(path, name, signal)
            time = _time(recording, rates[index], name, signal)
        except InputError as error:
            problems += [replace(problem, impact=impact or None) for problem in error.problems]
            continue
        taken[path] = name
        recordings.append((time, recording))
        files.append(name)
        kept.append(index)
    count = np.array([recording.value.size for _, recording in recordings], dtype=int)
    start = np.concatenate([[0], np.cumsum(count)]).astype(int)
    samples = Samples(
        np.concatenate([np.empty(0), *(time for time, _ in recordings)]),
        _converted(np.concatenate([np.empty(0), *(r.value for _, r in recordings)]), signal),
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
    return Reading(samples, problems, [folder / name for name in files])


def _converted(raw: np.ndarray, signal: SignalSettings) -> np.ndarray:
    # What overflows is found with everything else that is not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        return (raw * signal.scale + signal.offset) * to_si(signal.unit, signal.dimension)


def _in_seconds(time: np.ndarray, signal: SignalSettings) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        return time * to_si(signal.time_unit, "time")


def _the_one(folder: Path) -> Path:
    found = find_long(folder)
    if len(found) == 1:
        return found[0]
    raise InputError(
        Problem(
            found[0].name if found else LONG_TABLES[0],
            "one table of all samples, or a column trace in impacts.csv that names a file per impact",
            "Remove the others." if found else f"Add one of {', '.join(LONG_TABLES)}.",
            value=", ".join(path.name for path in found) or "no table of samples",
        )
    )


def _order(codes: np.ndarray) -> np.ndarray | slice:
    if codes.size and codes[0] >= 0 and (codes[1:] >= codes[:-1]).all():
        return slice(None)
    return np.argsort(codes, kind="stable")[np.count_nonzero(codes < 0) :]


def _moved(text: dict[int, str], order: np.ndarray | slice, rows: int) -> dict[int, str]:
    if not text:
        return {}
    where = np.arange(rows)[order]
    sites = np.flatnonzero(np.isin(where, list(text)))
    return {int(site): text[int(where[site])] for site in sites}


def _strangers(file: str, labels: Labels, codes: np.ndarray) -> list[Problem]:
    strange = np.flatnonzero(codes < 0)
    names, first = np.unique(labels.codes[strange], return_index=True)
    return [
        Problem(
            file,
            "an impact that impacts.csv has",
            "Add a row for it to impacts.csv, or take its samples out.",
            row=int(strange[index]) + 2,
            column="impact",
            value=labels.names[name] or "an empty cell",
            impact=labels.names[name] or None,
        )
        for name, index in zip(names, first, strict=True)
    ]


def _absent(file: str, impacts: list[str], place: dict[str, int], count: np.ndarray) -> list[Problem]:
    return [
        Problem(
            file,
            "samples of every impact in impacts.csv",
            "Add its samples, or take the impact out of impacts.csv.",
            column="impact",
            value="no samples",
            impact=impacts[index],
        )
        for index in np.flatnonzero(count == 0)
        # A name that stands there twice has been reported as such.
        if impacts[index] and place[impacts[index]] == index
    ]


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
        return _in_seconds(recording.time, signal)
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
