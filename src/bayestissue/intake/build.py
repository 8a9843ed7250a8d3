"""From files and facts to a dataset folder, read back and checked before anybody sees it."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import pandas as pd

from bayestissue.dataset import Dataset, Trace, read_dataset, write_dataset
from bayestissue.dataset.crop import COLUMNS as CROP
from bayestissue.dataset.settings import SignalSettings, parse_settings
from bayestissue.dataset.trace_files import read_one
from bayestissue.errors import InputError, Problem
from bayestissue.intake.choices import Choices
from bayestissue.intake.cutting import SEPARATION_S, THRESHOLD, cut
from bayestissue.intake.facts import Cells, Facts
from bayestissue.intake.folder import File, Found

RECORDINGS = "recordings"
_FIRST = ("impact", "subject", "trial", "mass_kg", "velocity_m_s")
_OPTIONS = {
    f"signal.{key}": f"--{option}"
    for key, option in (
        *(("quantity", "quantity"), ("unit", "unit"), ("time_unit", "time-unit"), ("scale", "scale")),
        *(("value_column", "channel"), ("time_column", "time"), ("offset", "offset")),
    )
}


@dataclass(frozen=True)
class Cutting:
    """How several impacts in one recording are told apart; see `cut`."""

    threshold: float = THRESHOLD
    separation_s: float = SEPARATION_S


@dataclass(frozen=True, eq=False)
class Built:
    """A dataset that was written and read back.

    Attributes:
        dataset: as it was read.
        left_out: what was wrong with files and impacts that are not in it.
        notes: what somebody should know who did not look at the recordings.
    """

    dataset: Dataset
    left_out: tuple[Problem, ...]
    notes: tuple[str, ...]


def build(
    folder: Path,
    found: Found,
    facts: Facts,
    choices: Choices,
    *,
    name: str,
    cutting: Cutting | None = None,
    skip_bad: bool = False,
) -> Built:
    """Write ``dataset.toml``, ``impacts.csv`` and the recordings, byte for byte as they are, and check them.

    Args:
        folder: where the dataset goes.
        found: the files.
        facts: what is known of each.
        choices: with no question left.
        name: of the dataset.
        cutting: cut several impacts in one recording apart; otherwise every recording holds one.
        skip_bad: leave out what is wrong, instead of refusing the whole.

    Raises:
        InputError: everything that is wrong, with the files, with what is known of them, and with the dataset
            that they make.
    """
    problems = [*found.problems, *facts.problems]
    settings = _settings(choices, name, len(found.files))
    signal = _signal(settings, problems)
    rows = list(_rows(found, facts, choices, signal, cutting, problems))
    if not rows:
        raise InputError(problems)
    _write(folder, settings, rows, found)
    try:
        dataset = read_dataset(folder)
    except InputError as error:
        by_trace = {f"{RECORDINGS}/{file.name}": file for file in found.files}
        by_impact = {row["impact"]: by_trace[row["trace"]] for row in rows}
        wrong = [_as_met(problem) for problem in error.problems]
        problems += wrong if cutting else [_hinted(problem, by_impact, signal, choices) for problem in wrong]
    if not problems:
        return Built(dataset, (), _notes(dataset, cutting))
    bad = {problem.impact for problem in problems}
    rows = [row for row in rows if row["impact"] not in bad]
    files = {file.name for file in found.files} | {problem.file for problem in found.problems}
    if not skip_bad or not rows or any(p.impact is None and p.file not in files for p in problems):
        raise InputError(problems)
    shutil.rmtree(folder / RECORDINGS)
    _write(folder, settings, rows, found)
    dataset = read_dataset(folder)
    return Built(dataset, tuple(problems), _notes(dataset, cutting))


def _settings(choices: Choices, name: str, files: int) -> dict[str, Any]:
    names = f", names read as {choices.pattern}" if choices.pattern else ""
    return {
        "name": name,
        "source": f"bayestissue init, from {files} recorder file{'s' if files > 1 else ''}{names}",
        "signal": choices.signal(),
    }


def _signal(settings: dict[str, Any], problems: list[Problem]) -> SignalSettings:
    try:
        return parse_settings(settings).signal
    except InputError as error:
        options = [
            replace(p, file="init", column=_OPTIONS.get(p.column or "", p.column)) for p in error.problems
        ]
        raise InputError([*problems, *options]) from None


def _rows(
    found: Found,
    facts: Facts,
    choices: Choices,
    signal: SignalSettings,
    cutting: Cutting | None,
    problems: list[Problem],
) -> Iterator[dict[str, Any]]:
    """The rows of ``impacts.csv``; what is wrong with a file goes to ``problems``."""
    bare = {file.name: file.name[: -len(file.suffix)] for file in found.files}
    short = Counter(PurePosixPath(name).name for name in bare.values())
    for file in found.files:
        if file.name not in facts.of_file:
            continue
        own = PurePosixPath(bare[file.name]).name
        base: dict[str, Any] = {
            "impact": own if short[own] == 1 else bare[file.name],
            "trace": f"{RECORDINGS}/{file.name}",
        }
        if choices.rate_hz is not None:
            base["sampling_rate_hz"] = choices.rate_hz
        try:
            if cutting is None:
                _require_one(file, facts)
                yield {**base, **facts.of_file[file.name]}
            else:
                for number, (cells, stretch) in enumerate(_pieces(file, facts, signal, cutting, choices), 1):
                    impact = f"{cells.get('impact', base['impact'])}-{number}"
                    yield {**base, **cells, "impact": impact, **dict(zip(CROP, stretch, strict=True))}
        except InputError as error:
            problems += error.problems


def _pieces(
    file: File, facts: Facts, signal: SignalSettings, cutting: Cutting, choices: Choices
) -> list[tuple[Cells, tuple[float, float]]]:
    trace = _oriented(file, signal, choices)
    stretches = cut(trace, threshold=cutting.threshold, separation_s=cutting.separation_s)
    numbers = [number for name, number in facts.of_number if name == file.name]
    if not stretches or (numbers and sorted(numbers) != list(range(1, len(stretches) + 1))):
        told = f"{len(numbers)} impacts, as many as the table has rows" if numbers else "at least one impact"
        raise InputError(
            Problem(
                file.name,
                told,
                "Change --threshold or --separation-s, or correct the table.",
                value=f"{len(stretches)} impacts",
            )
        )
    common = facts.of_file[file.name]
    return [
        (facts.of_number.get((file.name, number), common), stretch)
        for number, stretch in enumerate(stretches, 1)
    ]


def _require_one(file: File, facts: Facts) -> None:
    numbers = [number for name, number in facts.of_number if name == file.name]
    if len(numbers) > 1:
        remedy = "Add --several, so that the recording is cut apart."
        found = f"{len(numbers)} rows of the table"
        raise InputError(Problem(file.name, "one impact in the recording", remedy, value=found))


def _write(folder: Path, settings: dict[str, Any], rows: list[dict[str, Any]], found: Found) -> None:
    table = pd.DataFrame(rows)
    order = dict.fromkeys([*(name for name in _FIRST if name in table), *table.columns])
    write_dataset(folder, settings=settings, impacts=table[list(order)])
    for file in found.files:
        copy = folder / RECORDINGS / file.name
        if f"{RECORDINGS}/{file.name}" in set(table["trace"]):
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file.path, copy)


def _as_met(problem: Problem) -> Problem:
    """A problem of the dataset in the words of who has not seen it yet: their files, their options."""
    inside = f"{RECORDINGS}/"
    if problem.file.startswith(inside):
        return replace(problem, file=problem.file.removeprefix(inside))
    if problem.file == "impacts.csv":
        return replace(problem, file="impacts.csv as init would write it")
    return problem


def _hinted(problem: Problem, files: dict[str, File], signal: SignalSettings, choices: Choices) -> Problem:
    """The same with a way out, where the recording seems to hold several impacts."""
    file = files.get(problem.impact or "")
    if file is None or problem.file != file.name:
        return problem
    try:
        count = len(cut(_oriented(file, signal, choices)))
    except InputError:
        return problem
    hint = f" The recording seems to hold {count} impacts: --several cuts them apart." if count > 1 else ""
    return replace(problem, remedy=problem.remedy + hint)


def _oriented(file: File, signal: SignalSettings, choices: Choices) -> Trace:
    """A whole recording, positive while the impactor slows or into the tissue."""
    time, value = read_one(file.path, file.name, signal, choices.rate_hz or float("nan"))
    return Trace(time, -value if signal.quantity == "acceleration" else value)


def _notes(dataset: Dataset, cutting: Cutting | None) -> tuple[str, ...]:
    if cutting is not None:
        return ()
    several = _with_several(dataset)
    if not several:
        return ()
    more = f" and {len(several) - 5} more" if len(several) > 5 else ""
    named = f"{', '.join(several[:5])}{more}"
    advice = "the impact with the highest peak is used; --several cuts them apart"
    return (f"{named}: the recording seems to hold several impacts; {advice}.",)


def _with_several(dataset: Dataset) -> list[str]:
    sign = -1.0 if dataset.quantity == "acceleration" else 1.0
    oriented: Iterable[Trace] = (Trace(trace.time_s, sign * trace.value) for trace in dataset.traces)
    return [
        str(impact)
        for impact, trace in zip(dataset.impacts["impact"], oriented, strict=True)
        if len(cut(trace)) > 1
    ]
