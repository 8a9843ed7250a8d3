"""A folder of recorder files: which there are, and which channels each holds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from bayestissue.dataset.dialect import Stated
from bayestissue.dataset.files import of_part, read_bytes, sheet_names
from bayestissue.dataset.formats import Contents
from bayestissue.dataset.recorders import SUFFIXES, contents_of, is_text_of_numbers, suffix_of
from bayestissue.dataset.tables import TEXT_SUFFIXES
from bayestissue.dataset.traces import MIN_SAMPLES
from bayestissue.errors import InputError, Problem
from bayestissue.outline import first_of

_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class Steps:
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
    def from_values(cls, values: np.ndarray, first_row: int, falling: float = 0.05) -> Steps | None:
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
        gap = np.flatnonzero(step > max(1.5 * usual, usual + 1.5 * (high - low)))
        return cls(
            float(np.mean(step)),
            usual,
            float(step.max()),
            bool(step.min() > 0 and step.max() < 1.5 * np.median(step)),
            first_row + int(gap[0]) + 1 if gap.size else None,
        )


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
    steps: Steps | None

    @property
    def rising(self) -> bool:
        """Whether its values rise evenly, as times do."""
        return self.steps is not None and self.steps.rises


@dataclass(frozen=True)
class File:
    """One recorder file, or a part of one: a sheet of a workbook, or a block of LabVIEW's text.

    Attributes:
        path: where it lies; of a part as ``p1.xlsx#left`` or ``p1.lvm#2``.
        name: its path relative to the folder, with ``/`` between the parts.
        channels: by name, in the order of the file.
        written: how a text is written, in words; empty of other files.
    """

    path: Path
    name: str
    channels: dict[str, ChannelSummary]
    written: str = ""

    @property
    def suffix(self) -> str:
        """How its name ends; that of a part ends as the part is called."""
        return "" if of_part(self.path)[1] else suffix_of(self.path)


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
    files: tuple[File, ...]
    problems: tuple[Problem, ...]
    passed_over: tuple[str, ...] = ()

    def candidates(self) -> dict[str, list[ChannelSummary]]:
        """The channels by name, each as it is in every file that has one of that name."""
        candidates: dict[str, list[ChannelSummary]] = {}
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
        raise InputError.stated(
            "no-recordings.files",
            str(folder),
            value=f"files ending in {ends}" if paths else "no files",
            endings=suffix or ", ".join((*SUFFIXES, *TEXT_SUFFIXES)),
        )
    files: list[File] = []
    problems: list[Problem] = []
    books = _Books(sheets)
    for path in chain.from_iterable(map(books.parts, wanted)):
        name = path.relative_to(root).as_posix()
        try:
            contents = contents_of(path, name, stated)
        except InputError as error:
            problems += (replace(problem, files_read=len(wanted)) for problem in error.problems)
            continue
        blocks = {f"#{number}": block for number, block in enumerate(contents.blocks, 1)} or {"": contents}
        files += (_listed(path.with_name(path.name + part), name + part, blocks[part]) for part in blocks)
    files, problems = books.sorted_out(_with_numbers(files, always=sheets is True), problems)
    if not files:
        raise InputError(problems)
    return RecorderFolder(root, tuple(files), tuple(problems), books.words())


def _listed(path: Path, name: str, contents: Contents) -> File:
    channels = {
        key: ChannelSummary(
            channel.unit,
            channel.values.size,
            channel.clock is not None,
            Steps.from_values(channel.values, contents.first_row),
        )
        for key, channel in contents.channels.items()
    }
    return File(path, name, channels, contents.written)


def _with_numbers(files: list[File], *, always: bool) -> list[File]:
    """The files; where one text of LabVIEW holds several blocks, a text of a single block has a number too.

    One pattern can read names of one form alone.

    Args:
        files: of which those of several blocks are their blocks already.
        always: whether a single block has its number in any case.
    """
    if not always and all(file.suffix or of_part(file.path)[0].suffix == ".xlsx" for file in files):
        return files
    return [_first_block(file) if file.suffix and not file.written else file for file in files]


def _first_block(file: File) -> File:
    path = file.path.with_name(f"{file.path.name}#1")
    return replace(file, path=path, name=f"{file.name}#1") if of_part(path)[1] else file


class _Books:
    """Files of several parts among recorder files: workbooks, whose sheets may be recordings, and texts."""

    def __init__(self, each_sheet: bool | None) -> None:
        """Where ``each_sheet`` is False, take the first sheet of a workbook alone; see `look`."""
        self.each_sheet, self._passed_over = each_sheet, dict[str, list[str]]()

    def parts(self, path: Path) -> list[Path]:
        """The sheets of a workbook, by their names; another file as it is."""
        if suffix_of(path) != ".xlsx":
            return [path]
        try:
            shown, hidden = sheet_names(read_bytes(path, path.name, ""), path.name)
        except InputError:
            # Whoever reads it says what is wrong.
            return [path]
        self._over("hidden sheets", path, hidden)
        if self.each_sheet is False:
            self._over('sheets behind the first (--pattern "{subject}.xlsx#{}" reads each)', path, shown[1:])
        if self.each_sheet is False or not shown:
            return [path]
        return [path.with_name(f"{path.name}#{sheet}") for sheet in shown]

    def _over(self, what: str, path: Path, sheets: Sequence[str]) -> None:
        if sheets:
            self._passed_over.setdefault(what, []).append(f"{path.name} ({', '.join(sheets)})")

    def words(self) -> tuple[str, ...]:
        """What was passed over."""
        return tuple(f"{what}: {first_of(names, 3)}" for what, names in self._passed_over.items())

    def sorted_out(self, files: list[File], problems: list[Problem]) -> tuple[list[File], list[Problem]]:
        """The recordings, and what is wrong, without sheets and blocks that are empty or hold no recording.

        A workbook of one sheet with cells has its own name, unless each sheet is to be named or others have
        several.
        """
        of_book: dict[Path, list[File]] = {}
        for file in files:
            of_book.setdefault(of_part(Path(file.name))[0], []).append(file)
        blank = [p for p in problems if p.code == "no-rows" and of_part(Path(p.file))[0] in of_book]
        problems = [problem for problem in problems if problem not in blank]
        if self.each_sheet is None and not problems and all(len(sheets) == 1 for sheets in of_book.values()):
            return [_as_a_whole(file) for file in files], problems
        recordings: list[File] = []
        for book, sheets in of_book.items():
            held = [file for file in sheets if _holds_samples(file)] or sheets
            recordings += held
            kind = "sheets" if book.suffix == ".xlsx" else "blocks"
            self._over(
                f"{kind} without a recording", book, [of_part(f.path)[1] for f in sheets if f not in held]
            )
        return recordings, problems


def _as_a_whole(file: File) -> File:
    path, sheet = of_part(file.path)
    return replace(file, path=path, name=file.name.removesuffix(f"#{sheet}")) if sheet else file


def _holds_samples(file: File) -> bool:
    return any(channel.samples >= MIN_SAMPLES for channel in file.channels.values())


def files_within(folder: Path) -> list[Path]:
    """The files in a folder and in folders within it, by name; not hidden ones, nor those of datasets."""
    here = [path for path in folder.iterdir() if not path.name.startswith(".")]
    inner = [path for path in here if path.is_dir() and not path.is_symlink()]
    within = [path for part in inner if not (part / "dataset.toml").exists() for path in files_within(part)]
    return sorted([*(path for path in here if path.is_file()), *within], key=lambda p: natural(p.as_posix()))


def natural(name: str) -> list[tuple[int, str]]:
    """What orders names as people count: numbers in them by their size."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in _DIGITS.split(name)]
