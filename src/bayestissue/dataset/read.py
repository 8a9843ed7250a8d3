"""Read and check a dataset folder: everything that is wrong with it comes out at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayestissue.dataset.checks import check_recordings, stated_problems
from bayestissue.dataset.crop import Windows, crop
from bayestissue.dataset.impacts import FILE as IMPACTS
from bayestissue.dataset.impacts import ImpactTable, read_impacts
from bayestissue.dataset.long_table import find_long, read_long
from bayestissue.dataset.model import Dataset, Trace
from bayestissue.dataset.recordings import Reading, Recordings, Samples
from bayestissue.dataset.settings import FILE as SETTINGS
from bayestissue.dataset.settings import Settings, SignalSettings, read_settings
from bayestissue.dataset.trace_files import read_files
from bayestissue.errors import InputError, Problem, refusal
from bayestissue.runtime import content_hash

WORKBOOK = "impacts.xlsx"


def read_dataset(path: str | Path, *, skip_bad: bool = False) -> Dataset:
    """Read a dataset folder: ``dataset.toml``, ``impacts.csv`` (or ``.xlsx``) and the recordings.

    Args:
        path: the folder; ``docs/reference/dataset.md`` describes its layout.
        skip_bad: leave out impacts with something wrong, and say so in ``left_out``, instead of refusing
            the whole. What concerns the dataset as a whole is refused either way.

    Raises:
        InputError: everything that is wrong, each with its file, row, column, value, what was expected and
            how to mend it.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise refusal(
            str(path),
            "a folder with dataset.toml, impacts.csv and the recordings",
            "Check the path.",
            value="a file" if folder.exists() else "no such folder",
            code="no-dataset",
        )
    impacts = _impacts_file(folder)
    try:
        data = _read(folder, impacts, skip_bad=skip_bad)
    except InputError as error:
        raise InputError(_named(error.problems, impacts)) from None
    return replace(data, warnings=_named(data.warnings, impacts), left_out=_named(data.left_out, impacts))


def _named(problems: Iterable[Problem], impacts: Path) -> tuple[Problem, ...]:
    """What is wrong with impacts, by the name of the file that holds them."""
    return tuple(replace(p, file=impacts.name) if p.file == IMPACTS else p for p in problems)


def _read(folder: Path, impacts: Path, *, skip_bad: bool) -> Dataset:
    settings, table = _tables(folder, impacts)
    problems = list(table.problems)
    if "trace" in table.table:
        reading = _files(folder, table, settings)
    else:
        reading = _long(folder, table, settings, problems)
    hashed = content_hash([folder / SETTINGS, impacts, *reading.files])
    reading = replace(reading, problems=problems + reading.problems)
    return checked_dataset(settings, table, reading, skip_bad=skip_bad, folder=folder, input_hash=hashed)


def as_dataset(dataset: Dataset | str | Path) -> Dataset:
    """A dataset, or the one of a folder.

    Raises:
        InputError: as of `read_dataset`, or it is neither.
    """
    if isinstance(dataset, str | Path):
        return read_dataset(dataset)
    if not isinstance(dataset, Dataset):
        expected = "a dataset's folder, or what bayestissue.dataset or bayestissue.read_dataset returns"
        remedy = "Make one with bayestissue.dataset(impacts, traces, quantity=..., unit=...)."
        kind = type(dataset).__name__
        raise refusal("dataset", expected, remedy, value=kind, code="option-value")
    return dataset


def checked_dataset(
    settings: Settings,
    table: ImpactTable,
    reading: Reading,
    *,
    skip_bad: bool,
    folder: Path | None,
    input_hash: str,
) -> Dataset:
    """The dataset of what was read, by every check of recordings.

    Args:
        settings: what ``dataset.toml`` says.
        table: the impacts.
        reading: the recordings, and what is wrong so far with the impacts and with them.
        skip_bad: see `read_dataset`.
        folder: where it was read from, if from one.
        input_hash: of what was read.

    Raises:
        InputError: as of `read_dataset`.
    """
    signal, names = settings.signal, table.table["impact"].tolist()
    # Recorder files are cropped as they are read, for memory's sake: nothing more comes off here.
    samples, outside = crop(reading.samples, Windows.stated(table.table, signal), names)
    reading = replace(reading, samples=samples)
    problems = [*reading.problems, *outside]
    uncertainty = settings.uncertainty.values()
    gravity = signal.gravity_m_s2
    recorder = settings.recorder.values() if settings.recorder else None
    recordings = Recordings.with_impacts(
        reading.samples, table.table, signal.quantity, uncertainty, gravity, recorder
    )
    findings = check_recordings(recordings)
    problems += findings.problems
    problems += stated_problems(recordings.without(problems))
    _refuse(problems, skip_bad, table)
    bad = {problem.impact for problem in problems}
    unstated = _falls_unsaid(signal, table.table.columns)
    keep = ~table.table["impact"].isin(list(bad)).to_numpy()
    return Dataset(
        name=settings.name,
        description=settings.description,
        impacts=table.table[keep].reset_index(drop=True),
        traces=_traces(reading.samples, keep),
        quantity=signal.quantity,
        uncertainty=uncertainty,
        warnings=tuple(w for w in [*unstated, *table.warnings, *findings.warnings] if w.impact not in bad),
        left_out=tuple(problems),
        folder=folder,
        input_hash=input_hash,
        licence=settings.licence,
        source=settings.source,
        recorder=recorder,
        gravity=gravity,
    )


def _falls_unsaid(signal: SignalSettings, columns: Iterable[str]) -> Iterator[Problem]:
    """A height of fall where nothing says whether gravity acts along the motion."""
    heights = [name for name in columns if name.startswith("drop_height")]
    if heights and "gravity" not in signal.model_fields_set:
        yield Problem(
            SETTINGS,
            "whether gravity acts along the motion, since there is a height of fall",
            'Write gravity = "drop" under [signal] for an impactor that falls straight down, or "none" for a '
            "pendulum at its lowest point.",
            column="signal.gravity",
            value=f"a column {heights[0]}, and no signal.gravity",
            code="gravity",
        )


def _impacts_file(folder: Path) -> Path:
    """The table of impacts: a workbook where there is no text.

    Raises:
        InputError: there are both.
    """
    text, workbook = folder / IMPACTS, folder / WORKBOOK
    if not workbook.is_file():
        return text
    if text.is_file():
        expected = f"{IMPACTS} or {WORKBOOK}"
        remedy = "Take one of them out of the folder: nothing says which of them holds."
        raise InputError(Problem(WORKBOOK, expected, remedy, value="both", code="which-impacts"))
    return workbook


def _tables(folder: Path, impacts: Path) -> tuple[Settings, ImpactTable]:
    problems: list[Problem] = []
    settings = table = None
    try:
        settings = read_settings(folder / SETTINGS)
    except InputError as error:
        problems += error.problems
    needs_velocity = settings is not None and settings.signal.quantity != "displacement"
    try:
        table = read_impacts(impacts, needs_velocity=needs_velocity)
    except InputError as error:
        problems += error.problems
    if settings is None or table is None:
        raise InputError(problems + (table.problems if table else []))
    return settings, table


def _files(folder: Path, table: ImpactTable, settings: Settings) -> Reading:
    if tables := find_long(folder):
        raise InputError(
            [
                *table.problems,
                Problem(
                    tables[0].name,
                    "either one table of all samples or a file per impact",
                    "Remove the table, or the column trace from impacts.csv.",
                    value=f"{tables[0].name} beside a column trace in impacts.csv",
                    code="which-recordings",
                ),
            ]
        )
    return read_files(folder, table.table, table.row, settings.signal)


def _long(folder: Path, table: ImpactTable, settings: Settings, problems: list[Problem]) -> Reading:
    try:
        return read_long(folder, table.table["impact"].tolist(), settings.signal)
    except InputError as error:
        raise InputError([*problems, *error.problems]) from None


def _refuse(problems: list[Problem], skip_bad: bool, table: ImpactTable) -> None:
    if not problems:
        return
    if not skip_bad or any(problem.impact is None for problem in problems):
        raise InputError(problems)
    if set(table.table["impact"]) <= {problem.impact for problem in problems}:
        raise InputError(
            [
                *problems,
                Problem(
                    IMPACTS,
                    "at least one impact with nothing wrong",
                    "Mend the above.",
                    value="none left",
                    code="none-left",
                ),
            ]
        )


def _traces(samples: Samples, keep: np.ndarray) -> list[Trace]:
    return [
        Trace(samples.time[begin:end], samples.value[begin:end])
        for impact, begin, end in zip(samples.impact, samples.start[:-1], samples.start[1:], strict=True)
        if keep[impact]
    ]
