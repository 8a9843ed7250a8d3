"""A folder of recorder files: which there are, and which channels each holds."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayestissue.base.errors import InputError, Problem
from bayestissue.base.outline import first_of
from bayestissue.recordings.dataset.dialect import Stated
from bayestissue.recordings.dataset.formats.channel import Contents
from bayestissue.recordings.dataset.ragged_traces import MIN_SAMPLES
from bayestissue.recordings.dataset.recorders import SUFFIXES, contents_of, is_text_of_numbers
from bayestissue.recordings.dataset.sample_tables import TEXT_SUFFIXES
from bayestissue.recordings.dataset.source_files import Source, sheet_names, suffix_of

_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class RisingSteps:
    """From sample to sample of a channel that hardly ever falls, in its unit.

    Attributes:
        mean: of all steps.
        usual: the median of those that are not 0.
        longest: the greatest.
        rises: whether none is 0 and all are alike, as the steps of times are.
        gap: the row after the first step that is too long for times of a steady recorder, however coarse;
            None without one.
    """

    mean: float
    usual: float
    longest: float
    rises: bool
    gap: int | None

    @classmethod
    def from_values(cls, values: np.ndarray, first_row: int, falling: float = 0.05) -> RisingSteps | None:
        """None of a channel that falls at more than a share ``falling`` of steps, or ends in no number.

        A few steps fall in a channel of times of which some samples are out of order.
        """
        if values.size < 3 or not np.isfinite(values).all() or not values[-1] > values[0]:
            return None
        step = np.diff(values)
        if np.mean(step < 0) > falling:
            return None
        usual = float(np.median(step[step > 0]))
        low, high = np.quantile(step[step > 0], [0.05, 0.95])
        gaps = np.flatnonzero(step > max(1.5 * usual, usual + 1.5 * (high - low)))
        gap = first_row + int(gaps[0]) + 1 if gaps.size else None
        rises = bool(step.min() > 0 and step.max() < 1.5 * np.median(step))
        return cls(float(np.mean(step)), usual, float(step.max()), rises, gap)


@dataclass(frozen=True)
class ChannelSummary:
    """What is known of a channel before any of it is used.

    Attributes:
        unit: as the file states it; empty where it states none.
        samples: how many it has.
        clock: whether the file's format carries its times.
        steps: of its values, where these go up as times do.
    """

    unit: str
    samples: int
    clock: bool
    steps: RisingSteps | None


type Candidates = dict[str, list[ChannelSummary]]


@dataclass(frozen=True)
class RecorderFile:
    """One recorder file, or a part of one: a sheet of a workbook, or a block of LabVIEW's text.

    Attributes:
        source: the file, called by its path relative to the folder, with ``/`` between the parts.
        channels: by name, in the order of the file.
        written: how a text is written, in words; empty of other files.
    """

    source: Source
    channels: dict[str, ChannelSummary]
    written: str = ""

    @property
    def name(self) -> str:
        """Its path relative to the folder; of a part as ``p1.xlsx#left`` or ``p1.lvm#2``."""
        return self.source.label


@dataclass(frozen=True)
class RecorderFolder:
    """What a folder holds.

    Attributes:
        folder: as it was named.
        files: those that could be read, in order of their names, numbers in them in order of size.
        problems: what is wrong with the others.
        passed_over: what was not read and is no problem, in words.
    """

    folder: Path
    files: tuple[RecorderFile, ...]
    problems: tuple[Problem, ...]
    passed_over: tuple[str, ...] = ()

    def candidates(self) -> Candidates:
        """The channels by name, each as it is in every file that has one of that name."""
        candidates: Candidates = {}
        for file in self.files:
            for name, channel in file.channels.items():
                candidates.setdefault(name, []).append(channel)
        return candidates


def look(
    folder: str | Path,
    *,
    suffix: str = "",
    ignore: Sequence[Path] = (),
    stated: Stated | None = None,
    sheets: bool | None = None,
) -> RecorderFolder:
    """Find the recorder files in a folder and in folders within it, and list their channels.

    Hidden files, and folders that are datasets already, are left alone.

    Args:
        folder: where the recorder's files lie; nothing in it is changed.
        suffix: only files that end so, where a pattern or an option says which.
        ignore: files that are no recordings, such as a table of facts.
        stated: how texts are written, as far as somebody said so.
        sheets: whether each sheet of a workbook is a recording, or its first one alone; each, if None, where
            any workbook has several. Each block of a text of LabVIEW is one.

    Raises:
        InputError: it is no folder, or holds no recorder file.
    """
    root = Path(folder)
    if not root.is_dir():
        what = "a file" if root.exists() else "no such folder"
        raise InputError.stated("no-recordings.folder", str(folder), value=what)
    skipped = {path.resolve() for path in ignore}
    paths = [path for path in files_within(root) if path.resolve() not in skipped]
    # Where there is nothing else, texts are recordings; beside recordings they are notes.
    kinds = [(suffix,)] if suffix else [*([(".xlsx",)] if sheets else []), SUFFIXES, TEXT_SUFFIXES]
    sorted_out = ([path for path in paths if suffix_of(path) in kind] for kind in kinds)
    wanted = next(filter(None, sorted_out), []) or [path for path in paths if is_text_of_numbers(path)]
    if not wanted:
        ends = ", ".join(sorted({suffix_of(path) or path.name for path in paths})[:10])
        present = f"files ending in {ends}" if paths else "no files"
        endings = suffix or ", ".join((*SUFFIXES, *TEXT_SUFFIXES))
        raise InputError.stated("no-recordings.files", str(folder), value=present, endings=endings)
    files: list[RecorderFile] = []
    problems: list[tuple[Source, Problem]] = []
    passed_over: dict[str, list[str]] = {}
    for path in wanted:
        whole = Source(path, path.relative_to(root).as_posix(), stated=stated)
        for source in _sheets(whole, sheets, passed_over):
            try:
                files += _listed(source, contents_of(source))
            except InputError as error:
                problems += ((source, replace(p, files_read=len(wanted))) for p in error.problems)
    recordings, left = _sorted_out(files, problems, sheets, passed_over)
    if not recordings:
        raise InputError(left)
    words = tuple(f"{what}: {first_of(names, 3)}" for what, names in passed_over.items())
    return RecorderFolder(root, tuple(recordings), tuple(left), words)


def _listed(source: Source, contents: Contents) -> list[RecorderFile]:
    """The recordings of a file that was read: each block of LabVIEW's text is one."""
    blocks = enumerate(contents.blocks, 1)
    parts = [(replace(source, part=str(number)), block) for number, block in blocks] or [(source, contents)]
    return [RecorderFile(part, _summaries(block), str(block.dialect or "")) for part, block in parts]


def _summaries(contents: Contents) -> dict[str, ChannelSummary]:
    summaries = {}
    for name, c in contents.channels.items():
        steps = RisingSteps.from_values(c.values, contents.first_row)
        summaries[name] = ChannelSummary(c.unit, c.values.size, c.clock is not None, steps)
    return summaries


def _sheets(file: Source, separate: bool | None, passed_over: dict[str, list[str]]) -> list[Source]:
    """The sheets of a workbook, the first alone where ``separate`` is False; another file as it is."""
    if not file.is_sheet:
        return [file]
    try:
        shown, hidden = sheet_names(file.read(), file.path.name)
    except InputError:
        # Whoever reads it says what is wrong.
        return [file]
    _note("hidden sheets", file, hidden, passed_over)
    if separate is False:
        what = 'sheets behind the first (--pattern "{subject}.xlsx#{}" reads each)'
        _note(what, file, shown[1:], passed_over)
    return [file] if separate is False or not shown else [replace(file, part=sheet) for sheet in shown]


def _note(what: str, file: Source, parts: Sequence[str], passed_over: dict[str, list[str]]) -> None:
    if parts:
        passed_over.setdefault(what, []).append(f"{file.path.name} ({', '.join(parts)})")


def _sorted_out(
    files: list[RecorderFile],
    problems: list[tuple[Source, Problem]],
    separate: bool | None,
    passed_over: dict[str, list[str]],
) -> tuple[list[RecorderFile], list[Problem]]:
    """The recordings, and what is wrong, without parts that are empty or hold no recording.

    A file of one part has its own name, unless each part is to be named or others have several: one pattern
    can read names of one form alone.
    """
    by_file: dict[Path, list[RecorderFile]] = {}
    for file in files:
        by_file.setdefault(file.source.path, []).append(file)
    problems = [(s, p) for s, p in problems if not (p.code == "no-rows" and s.path in by_file)]
    count = Counter(source.path for source in (*(file.source for file in files), *(s for s, _ in problems)))
    several = {parts[0].source.is_sheet for path, parts in by_file.items() if count[path] > 1}
    recordings: list[RecorderFile] = []
    for parts in by_file.values():
        longest = [max((channel.samples for channel in f.channels.values()), default=0) for f in parts]
        held = [f for f, samples in zip(parts, longest, strict=True) if samples >= MIN_SAMPLES] or parts
        source = parts[0].source
        what = f"{'sheets' if source.is_sheet else 'blocks'} without a recording"
        _note(what, source, [file.source.part for file in parts if file not in held], passed_over)
        named = separate or source.is_sheet in several
        recordings += held if named else [replace(f, source=replace(f.source, part="")) for f in held]
    return recordings, [problem for _, problem in problems]


def files_within(folder: Path) -> list[Path]:
    """The files in a folder and in folders within it, by name; not hidden ones, nor those of datasets."""
    here = [path for path in folder.iterdir() if not path.name.startswith(".")]
    inner = [path for path in here if path.is_dir() and not path.is_symlink()]
    within = [path for part in inner if not (part / "dataset.toml").exists() for path in files_within(part)]
    return sorted([*(path for path in here if path.is_file()), *within], key=lambda p: natural(p.as_posix()))


def natural(name: str) -> list[tuple[int, str]]:
    """What orders names as people count: numbers in them by their size."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in _DIGITS.split(name)]
