"""Read and check a dataset folder: everything that is wrong with it comes out at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd

from bayestissue.base.errors import InputError, Problem, along_with, collected
from bayestissue.base.runtime import content_hash
from bayestissue.recordings.dataset.cells import FILE as IMPACTS
from bayestissue.recordings.dataset.cells import HEIGHTS, REMEDY, is_height, read_cells
from bayestissue.recordings.dataset.dataset_file import FILE as SETTINGS
from bayestissue.recordings.dataset.dataset_file import (
    STANDARD_GRAVITY,
    ChannelSettings,
    Settings,
    SignalSettings,
    read_settings,
    reworded,
)
from bayestissue.recordings.dataset.impact_table import ImpactTable, impact_table, required_columns
from bayestissue.recordings.dataset.left_out import FILE as LEFT_OUT
from bayestissue.recordings.dataset.left_out import read_left_out
from bayestissue.recordings.dataset.model import Dataset
from bayestissue.recordings.dataset.plausible import PLAUSIBLE
from bayestissue.recordings.dataset.ragged_traces import PerImpact
from bayestissue.recordings.dataset.recorders import read_recordings
from bayestissue.recordings.dataset.recording_checks import (
    OF_SAMPLES,
    against_first,
    check_recordings,
    stated_problems,
)
from bayestissue.recordings.dataset.recordings import Recordings
from bayestissue.recordings.dataset.source_files import Source

WORKBOOK = "impacts.xlsx"


def read_dataset(path: str | Path, *, skip_bad: bool = False, whole: bool = False) -> Dataset:
    """Read a dataset folder: ``dataset.toml``, ``impacts.csv`` (or ``.xlsx``) and the recordings.

    Impacts that ``left_out.csv`` names are in ``left_out``, whatever is wrong with them.

    Args:
        path: the folder; ``docs/reference/dataset.md`` describes its layout.
        skip_bad: leave out impacts with something wrong, and say so in ``left_out``, instead of refusing
            the whole. What concerns the dataset as a whole is refused either way.
        whole: use what ``left_out.csv`` names as well.

    Raises:
        InputError: everything that is wrong, each with its file, row, column, value, what was expected and
            how to mend it.
    """
    folder = Path(path)
    if not folder.is_dir():
        actual = "a file" if folder.exists() else "no such folder"
        raise InputError.stated("no-dataset.folder", str(path), value=actual)
    impacts = _impacts_file(folder)
    words = partial(reworded, files={IMPACTS: impacts.name}, names={})
    return in_words(partial(_read, folder, impacts, skip_bad=skip_bad, whole=whole), words, impacts.name)


def in_words(make: Callable[[], Dataset], words: Callable[[Problem], Problem], table: str) -> Dataset:
    """A dataset, all that is wrong with it in the words of who made it.

    Args:
        make: the dataset.
        words: the problem in these words.
        table: what they call the table of impacts.
    """
    try:
        data = make()
    except InputError as error:
        raise InputError(map(words, error.problems)) from None
    warnings, left_out = (tuple(map(words, problems)) for problems in (data.warnings, data.left_out))
    return replace(data, warnings=warnings, left_out=left_out, table=table)


def _read(folder: Path, impacts: Path, *, skip_bad: bool, whole: bool) -> Dataset:
    settings, table = _tables(folder, impacts)
    with along_with(table.problems):
        recordings = read_recordings(folder, table, settings)
        by_hand, unknown = ([], []) if whole else read_left_out(folder, table.table["impact"])
    files = list(
        dict.fromkeys([folder / SETTINGS, impacts, *chain.from_iterable(r.paths for r in recordings)])
    )
    whole_hash = hashed = content_hash(files)
    if not whole and (folder / LEFT_OUT).exists():
        hashed = content_hash([*files, folder / LEFT_OUT])
    table = replace(table, warnings=[*unknown, *table.warnings])
    data = checked_dataset(table, recordings, by_hand, skip_bad=skip_bad)
    return replace(data, folder=folder, input_hash=hashed, whole_hash=whole_hash)


def as_dataset(dataset: Dataset | str | Path) -> Dataset:
    """A dataset, or the one of a folder.

    Raises:
        InputError: as of `read_dataset`, or it is neither.
    """
    if isinstance(dataset, str | Path):
        return read_dataset(dataset)
    if not isinstance(dataset, Dataset):
        kind = type(dataset).__name__
        raise InputError.stated("option-value.dataset", "dataset", value=kind)
    return dataset


def checked_dataset(
    table: ImpactTable,
    recordings: Sequence[Recordings],
    by_hand: Sequence[Problem] = (),
    *,
    skip_bad: bool = False,
) -> Dataset:
    """The dataset of what was read, by every check of recordings.

    Args:
        table: the impacts.
        recordings: of the first channel, and of each further one.
        by_hand: of the impacts that somebody left out.
        skip_bad: see `read_dataset`.

    Raises:
        InputError: as of `read_dataset`.
    """
    _refuse_none_left(by_hand, table)
    # Recorder files are cropped as they are read, for memory's sake: nothing more comes off here.
    first, *others = (one.cropped.with_limits for one in recordings)
    settings, impacts = first.settings, table.table
    first = check_recordings(first.without(by_hand))
    problems = [*table.problems, *first.problems]
    problems += stated_problems(first.without(problems))
    sound = first.without(problems)
    further = [_checked_channel(*pair, sound) for pair in zip(settings.channel, others, strict=True)]
    problems += [problem for one in further for problem in one.problems]
    chosen = {problem.impact for problem in by_hand}
    problems = [problem for problem in problems if problem.impact not in chosen]
    if problems and (not skip_bad or any(problem.impact is None for problem in problems)):
        raise InputError(problems)
    problems = [*by_hand, *problems]
    _refuse_none_left(problems, table)
    bad = {problem.impact for problem in problems}
    warnings, heights = list(table.warnings), list(filter(is_height, map(str, impacts)))
    if heights and "gravity" not in settings.signal.model_fields_set:
        # Nothing says whether gravity acts along the motion.
        value = f"a column {heights[0]}, and no signal.gravity"
        warnings = [Problem.stated("gravity", SETTINGS, column="signal.gravity", value=value), *warnings]
    warnings += [*_falls_contradicted(settings.signal, table), *first.warnings]
    keep = ~impacts["impact"].isin(list(bad)).to_numpy()
    return Dataset(
        settings.in_si(),
        impacts[keep].reset_index(drop=True),
        first.traces_of(keep),
        tuple(one.traces_of(keep) for one in further),
        warnings=tuple(warning for warning in warnings if warning.impact not in bad),
        left_out=tuple(problems),
        rows=dict(zip(impacts["impact"], map(int, table.row), strict=True)),
    )


def _checked_channel(channel: ChannelSettings, recordings: Recordings, first: Recordings) -> Recordings:
    """A further channel's recordings with all that is wrong with them.

    Samples and clocks as of the first channel, and what `against_first` finds.

    Args:
        channel: what ``dataset.toml`` says of it.
        recordings: cropped.
        first: the first channel, of impacts with nothing wrong so far.
    """
    if channel.file is not None:
        # The rate that impacts.csv states is the first channel's.
        impacts = recordings.impacts.drop(columns="sampling_rate_hz", errors="ignore")
        recordings = replace(recordings, impacts=impacts)
    checked = check_recordings(recordings, OF_SAMPLES)
    return replace(checked, problems=[*checked.problems, *against_first(checked, first)])


def _falls_contradicted(signal: SignalSettings, table: ImpactTable) -> Iterator[Problem]:
    """Rows of straight falls whose height and velocity at contact, √(2 g h), differ beyond their last digits.

    A velocity that was measured, and not computed, is some hundredths lower in every row, which is no slip.
    """
    columns = [name for name in HEIGHTS if name in table.table]
    if signal.gravity != "drop" or not columns:
        return
    (name, *_), velocity = columns, table.table["velocity_m_s"].to_numpy()
    height = pd.to_numeric(table.table[name], errors="coerce").to_numpy(float)
    fallen = np.sqrt(2 * STANDARD_GRAVITY * HEIGHTS[name] * np.where(height > 0, height, np.nan))
    rounding = _last_digit(height) / (4 * height) * fallen + _last_digit(velocity) / 2
    off = np.abs(velocity - fallen)
    agree = off <= rounding * (1 + 1e-9)
    wrong = (off > rounding * (1 + 1e-9)) & (agree.any() | (off > PLAUSIBLE.fall_off * fallen))
    for at in np.flatnonzero(wrong):
        words = {"height": height[at], "name": name, "fallen": fallen[at]}
        where = IMPACTS, table.row[at], f"velocity_m_s and {name}"
        value, impact = f"{velocity[at]:g} m/s and {height[at]:g}", str(table.table["impact"].iloc[at])
        yield Problem.stated("unusual-value.fall", *where, value, impact=impact, **words)


def _last_digit(values: PerImpact) -> PerImpact:
    """What a unit of the last digit of each number is, as it would be written."""
    return np.array([10.0 ** -len(f"{value:.12g}".partition(".")[2]) for value in values])


def _impacts_file(folder: Path) -> Path:
    """The table of impacts: a workbook where there is no text.

    Raises:
        InputError: there are both.
    """
    text, workbook = folder / IMPACTS, folder / WORKBOOK
    if text.is_file() and workbook.is_file():
        raise InputError.stated("which-impacts", WORKBOOK, value="both")
    return workbook if workbook.is_file() else text


def _tables(folder: Path, impacts: Path) -> tuple[Settings, ImpactTable]:
    problems: list[Problem] = []
    settings = table = None
    with collected(problems):
        settings = read_settings(folder / SETTINGS)
    needs_velocity = settings is not None and settings.needs_velocity
    signal = settings.signal if settings else None
    with collected(problems):
        source = Source.at(impacts, remedy=REMEDY, stated=signal)
        cells, rows = read_cells(source, required_columns(needs_velocity=needs_velocity))
        table = impact_table(cells, rows, needs_velocity=needs_velocity)
    if settings is None or table is None:
        raise InputError(problems + (table.problems if table else []))
    return settings, table


def _refuse_none_left(problems: Sequence[Problem], table: ImpactTable) -> None:
    if problems and set(table.table["impact"]) <= {problem.impact for problem in problems}:
        raise InputError([*problems, Problem.stated("none-left", IMPACTS, value="none left")])
