"""All samples of a dataset in one long table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from bayestissue.dataset.recordings import Reading, Samples, in_seconds, in_si
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.tables import Labels, Numbers, read_table
from bayestissue.errors import Problem, refusal

LONG_TABLES = ("traces.csv", "traces.csv.gz", "traces.xlsx", "traces.parquet")


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
    table = read_table(
        path,
        path.name,
        numbers=[signal.time_column, signal.value_column],
        labels=["impact"],
        remedy="Put the file there.",
        stated=signal.stated,
    )
    times, readings = table.numbers[signal.time_column], table.numbers[signal.value_column]
    rows = table.first_row + np.arange(times.array.size)
    return replace(
        long_reading(path.name, times, readings, table.labels["impact"], rows, impacts, signal), files=[path]
    )


def long_reading(
    label: str,
    times: Numbers,
    readings: Numbers,
    labels: Labels,
    rows: Int[np.ndarray, " row"],
    impacts: list[str],
    signal: SignalSettings,
) -> Reading:
    """The recordings in columns that were read already, sorted by impact.

    Args:
        label: what messages call the table.
        times: in its unit.
        readings: in their unit.
        labels: of each sample its impact.
        rows: of each sample what messages call its row.
        impacts: the names that there should be, in order.
        signal: names of the columns, units, scale and offset.
    """
    position = {name: index for index, name in reversed(list(enumerate(impacts)))}
    codes = np.array([position.get(name, -1) for name in labels.names], int)[labels.codes]
    order = _order(codes)
    count = np.bincount(codes[codes >= 0], minlength=len(impacts))
    has = np.flatnonzero(count)
    samples = Samples(
        in_seconds(times.array[order], signal),
        in_si(readings.array[order], signal),
        np.concatenate([[0], np.cumsum(count[has])]),
        has,
        [label] * has.size,
        rows[order],
        signal.time_column,
        signal.value_column,
        _reordered_text({**times.text, **readings.text}, order, codes.size),
    )
    return Reading(
        samples,
        _unknown_impacts(label, labels, codes, rows)
        + _impacts_without_samples(label, impacts, position, count),
        [],
    )


def _the_one(folder: Path) -> Path:
    tables = find_long(folder)
    if len(tables) == 1:
        return tables[0]
    raise refusal(
        tables[0].name if tables else LONG_TABLES[0],
        "one table of all samples, or a column trace in impacts.csv that names a file per impact",
        "Remove the others." if tables else f"Add one of {', '.join(LONG_TABLES)}.",
        value=", ".join(path.name for path in tables) or "no table of samples",
        code="which-recordings",
    )


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


def _unknown_impacts(file: str, labels: Labels, codes: np.ndarray, rows: np.ndarray) -> list[Problem]:
    strange = np.flatnonzero(codes < 0)
    names, first = np.unique(labels.codes[strange], return_index=True)
    return [
        Problem(
            file,
            "an impact that impacts.csv has",
            "Add a row for it to impacts.csv, or take its samples out.",
            row=int(rows[strange[index]]),
            column="impact",
            value=labels.names[name] or "an empty cell",
            impact=labels.names[name] or None,
            code="impacts-and-recordings",
        )
        for name, index in zip(names, first, strict=True)
    ]


def _impacts_without_samples(
    file: str, impacts: list[str], position: dict[str, int], count: np.ndarray
) -> list[Problem]:
    return [
        Problem(
            file,
            "samples of every impact in impacts.csv",
            "Add its samples, or take the impact out of impacts.csv.",
            column="impact",
            value="no samples",
            impact=impacts[index],
            code="impacts-and-recordings",
        )
        for index in np.flatnonzero(count == 0)
        # A name that stands there twice has been reported as such.
        if impacts[index] and position[impacts[index]] == index
    ]
