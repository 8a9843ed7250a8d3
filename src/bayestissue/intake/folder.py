"""A folder of recorder files: which there are, and which channels each holds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayestissue.dataset.dialect import Stated
from bayestissue.dataset.recorders import SUFFIXES, contents_of, suffix_of
from bayestissue.dataset.tables import TEXT_SUFFIXES
from bayestissue.errors import InputError, Problem

_DIGITS = re.compile(r"(\d+)")
# Of the steps of a channel of times in which some samples are out of order.
_FALLING = 0.05


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
    def of(cls, values: np.ndarray, first_row: int) -> Steps | None:
        """None of a channel that falls at more than one in twenty steps, or that has no end of numbers."""
        if values.size < 3 or not np.isfinite(values).all() or not values[-1] > values[0]:
            return None
        step = np.diff(values)
        if np.mean(step < 0) > _FALLING:
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
    """One recorder file.

    Attributes:
        path: where it lies.
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
        """How its name ends."""
        return suffix_of(self.path)


@dataclass(frozen=True)
class RecorderFolder:
    """What a folder holds.

    Attributes:
        folder: as it was named.
        files: those that could be read, in order of their names, numbers in them in order of size.
        problems: what is wrong with the others.
    """

    folder: Path
    files: tuple[File, ...]
    problems: tuple[Problem, ...]

    def candidates(self) -> dict[str, list[ChannelSummary]]:
        """The channels by name, each as it is in every file that has one of that name."""
        candidates: dict[str, list[ChannelSummary]] = {}
        for file in self.files:
            for name, channel in file.channels.items():
                candidates.setdefault(name, []).append(channel)
        return candidates


def look(
    folder: str | Path, *, suffix: str = "", ignore: Sequence[Path] = (), stated: Stated | None = None
) -> RecorderFolder:
    """Find the recorder files in a folder and in folders within it, and list their channels.

    Hidden files, and folders that are datasets already, are left alone.

    Args:
        folder: where the recorder's files lie; nothing in it is changed.
        suffix: only files that end so, where a pattern or an option says which.
        ignore: files that are no recordings, such as a table of facts.
        stated: how texts are written, as far as somebody said so.

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
    kinds = [(suffix,)] if suffix else [SUFFIXES, TEXT_SUFFIXES]
    sorted_out = ([path for path in paths if suffix_of(path) in kind] for kind in kinds)
    wanted = next(filter(None, sorted_out), [])
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
    for path in wanted:
        name = path.relative_to(root).as_posix()
        try:
            contents = contents_of(path, name, stated)
        except InputError as error:
            problems += (replace(problem, files_read=len(wanted)) for problem in error.problems)
            continue
        files.append(
            File(
                path,
                name,
                {
                    key: ChannelSummary(
                        channel.unit,
                        channel.values.size,
                        channel.clock is not None,
                        Steps.of(channel.values, contents.first_row),
                    )
                    for key, channel in contents.channels.items()
                },
                contents.written,
            )
        )
    if not files:
        raise InputError(problems)
    return RecorderFolder(root, tuple(files), tuple(problems))


def files_within(folder: Path) -> list[Path]:
    """The files in a folder and in folders within it, by name; not hidden ones, nor those of datasets."""
    here = [path for path in folder.iterdir() if not path.name.startswith(".")]
    inner = [path for path in here if path.is_dir() and not path.is_symlink()]
    within = [path for part in inner if not (part / "dataset.toml").exists() for path in files_within(part)]
    return sorted([*(path for path in here if path.is_file()), *within], key=lambda p: natural(p.as_posix()))


def natural(name: str) -> list[tuple[int, str]]:
    """What orders names as people count: numbers in them by their size."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in _DIGITS.split(name)]
