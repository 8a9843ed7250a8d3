"""The recordings of a dataset: one long table of all samples, or a recorder file for each impact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int

from bayestissue.dataset.files import Source, require_small
from bayestissue.dataset.formats import Channel, Contents, Labels
from bayestissue.dataset.recorders import read_recording, times_of, with_own_clock
from bayestissue.dataset.recordings import Reading, Samples, Windows, crop, in_si, numbers_in
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import read_table
from bayestissue.dataset.traces import Trace
from bayestissue.errors import InputError, Problem

LONG_TABLES = ("traces.csv", "traces.csv.gz", "traces.xlsx", "traces.parquet")


def find_long(folder: Path) -> list[Path]:
    """The trace tables in a dataset's folder; there should be one."""
    return [folder / name for name in LONG_TABLES if (folder / name).exists()]


def read_long(
    folder: Path,
    impacts: list[str],
    signal: SignalSettings,
    file: str | None = None,
    first: SignalSettings | None = None,
) -> Reading:
    """Read the one long table of all samples.

    Args:
        folder: the dataset's.
        impacts: the names in ``impacts.csv``, in order.
        signal: names of the columns, units, scale and offset.
        file: the name of the table; one of `LONG_TABLES` unless given.
        first: of a further channel the settings of the first one, which stands in the same table.

    Raises:
        InputError: there is no such table, or more than one, or it can't be read.
    """
    paths = find_long(folder) if file is None else [folder / file]
    if len(paths) > 1:
        listed = ", ".join(path.name for path in paths)
        raise InputError.stated("which-recordings.several", paths[0].name, value=listed)
    if not paths:
        tables, value = ", ".join(LONG_TABLES), "no table of samples"
        raise InputError.stated("which-recordings.no-table", LONG_TABLES[0], value=value, tables=tables)
    columns = {"numbers": [signal.time_column, signal.value_column], "labels": ["impact"]}
    read = partial(read_table, Source(paths[0], paths[0].name, stated=signal), **columns)
    table, signal = with_own_clock(read, signal, first, paths[0].name)
    rows = table.first_row + np.arange(table.labels["impact"].codes.size)
    return replace(long_reading(paths[0].name, table, rows, impacts, signal), files=paths)


def long_reading(
    file: str, table: Contents, rows: Int[np.ndarray, " row"], impacts: list[str], signal: SignalSettings
) -> Reading:
    """The recordings in columns that were read already, sorted by impact.

    Args:
        file: what messages call the table.
        table: impact, time and value of each sample, in their units.
        rows: of each sample what messages call its row.
        impacts: the names that there should be, in order.
        signal: names of the columns, units, scale and offset.
    """
    times, readings = table.channels[signal.time_column], table.channels[signal.value_column]
    labels = table.labels["impact"]
    position = {name: index for index, name in reversed(list(enumerate(impacts)))}
    codes = np.array([position.get(name, -1) for name in labels.names], int)[labels.codes]
    order = _order(codes)
    count = np.bincount(codes[codes >= 0], minlength=len(impacts))
    has = np.flatnonzero(count)
    samples = Samples(
        times_of(times, signal)[order],
        in_si(readings.values, signal)[order],
        np.concatenate([[0], np.cumsum(count[has])]),
        has,
        [file] * has.size,
        rows[order],
        signal.time_column,
        signal.value_column,
        _reordered_text({**times.text, **readings.text}, order, codes.size),
    )
    missing = [
        Problem.stated("impacts-and-recordings.missing", file, None, "impact", "no samples", impact=name)
        for index, name in enumerate(impacts)
        # A name that stands there twice has been reported as such.
        if not count[index] and name and position[name] == index
    ]
    return Reading(samples.to_their_ends, [*_unknown_impacts(file, labels, codes, rows), *missing], [])


def _order(codes: np.ndarray) -> np.ndarray | slice:
    if codes.size and codes[0] >= 0 and (codes[1:] >= codes[:-1]).all():
        return slice(None)
    return np.argsort(codes, kind="stable")[np.count_nonzero(codes < 0) :]


def _reordered_text(text: dict[int, str], order: np.ndarray | slice, rows: int) -> dict[int, str]:
    if not text:
        return {}
    where = np.arange(rows)[order]
    sites = np.flatnonzero(np.isin(where, list(text)))
    return {int(site): text[int(where[site])] for site in sites}


def _unknown_impacts(file: str, labels: Labels, codes: np.ndarray, rows: np.ndarray) -> Iterator[Problem]:
    strange = np.flatnonzero(codes < 0)
    for code, index in zip(*np.unique(labels.codes[strange], return_index=True), strict=True):
        name, row = labels.names[code], rows[strange[index]]
        value = name or "an empty cell"
        yield Problem.stated("impacts-and-recordings.unknown", file, row, "impact", value, impact=name)


def read_files(
    folder: Path,
    impacts: pd.DataFrame,
    rows: np.ndarray,
    signal: SignalSettings,
    first: SignalSettings | None = None,
) -> Reading:
    """Read one recorder file per impact, as the column ``trace`` names them.

    Args:
        folder: the dataset's.
        impacts: with the columns ``impact``, ``trace`` and perhaps ``sampling_rate_hz``.
        rows: for every impact its row in ``impacts.csv``.
        signal: names of the channels, units, scale and offset.
        first: of a further channel the settings of the first one.
    """
    problems: list[Problem] = []
    pieces: list[Samples] = []
    names = impacts["impact"].tolist()
    rates, windows = numbers_in(impacts, "sampling_rate_hz"), Windows.stated(impacts, signal)
    taken: dict[Source, list[int]] = {}
    held: tuple[tuple[Source, str], Samples] | None = None
    size = 0
    for index, name in enumerate(impacts["trace"]):
        try:
            source = _inside(folder, name, int(rows[index]))
            _require_apart(source, index, int(rows[index]), taken, windows)
            # One that several impacts share is read once: they mostly follow each other.
            key = (source, str(rates[index]))
            if held is None or held[0] != key:
                held = key, _samples(read_recording(source, signal, first), rates[index], name, signal)
            whole = replace(held[1], impact=np.array([index]), file=[name])
        except InputError as error:
            of_impact = partial(replace, impact=names[index] or None, files_read=len(impacts))
            problems += map(of_impact, error.problems)
            continue
        taken.setdefault(source, []).append(index)
        piece, outside = crop(whole, windows, names)
        problems += outside
        if not outside:
            size += piece.time_s.nbytes + piece.value.nbytes
            require_small(size, "the recordings together")
            pieces.append(piece)
    files = list(dict.fromkeys(source.path for source in taken))
    return Reading(Samples.joined(pieces, signal), problems, files)


def read_one(source: Source, signal: SignalSettings, rate: float = np.nan) -> Trace:
    """A whole recording, in SI units.

    Args:
        source: the file.
        signal: names of the channels, units, scale and offset.
        rate: the sampling rate in Hz, where the file has no times.

    Raises:
        InputError: the file is missing or damaged, lacks a channel, or has no times.
    """
    return _samples(read_recording(source, signal), rate, source.label, signal)[0]


def _samples(recorded: Channel, rate: float, file: str, signal: SignalSettings) -> Samples:
    """The recording in SI units, its times by the sampling rate (Hz) where it has none."""
    time, count = recorded.clock, len(recorded.values)
    if time is None and np.isfinite(rate):
        time = np.arange(count) / rate
    if time is None:
        raise InputError.stated("no-times", file, column=signal.time_column, value="no times")
    start, rows = np.array([0, count]), np.arange(count) if recorded.rows is None else recorded.rows
    names, value = (signal.time_column, signal.value_column), in_si(recorded.values, signal)
    return Samples(time, value, start, np.array([0]), [file], rows, *names, recorded.text).to_their_ends


def _require_apart(
    source: Source, index: int, row: int, taken: dict[Source, list[int]], windows: Windows
) -> None:
    """Refuse a recording, or a part of one, that an earlier impact has."""
    if any(windows.meet(index, neighbour) for neighbour in taken.get(source, ())):
        start, stop = windows.start[index], windows.stop[index]
        cropped = np.isfinite(start) or np.isfinite(stop)
        value = f"{source.label}, from {start:.6g} to {stop:.6g} s" if cropped else source.label
        raise InputError.stated("impacts-and-recordings.shared", "impacts.csv", row, "trace", value)


def _inside(folder: Path, name: str, row: int) -> Source:
    if not name:
        raise InputError.stated("which-recordings.none", "impacts.csv", row, "trace", "an empty cell")
    try:
        path = (folder / name).resolve()
        outside = Path(name).is_absolute() or not path.is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):
        outside = True
    if outside:
        raise InputError.stated("which-recordings.outside", "impacts.csv", row, "trace", name)
    remedy = "Correct the cell in column trace of impacts.csv, or put the file there."
    return Source.at(path, name, remedy=remedy)
