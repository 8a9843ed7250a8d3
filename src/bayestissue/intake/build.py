"""From files and facts to a dataset folder, read back and checked before anybody sees it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from bayestissue.dataset import Dataset, Trace, read_dataset, write_dataset
from bayestissue.dataset.settings import FILE as SETTINGS
from bayestissue.dataset.settings import SignalSettings, TextSettings, parse_settings
from bayestissue.errors import InputError, Problem
from bayestissue.intake.choices import Choices
from bayestissue.intake.facts import Facts
from bayestissue.intake.folder import File, RecorderFolder
from bayestissue.intake.rows import RECORDINGS, Cutting, cut, impact_rows, oriented, stated_rate
from bayestissue.outline import first_of

_FIRST = ("impact", "subject", "trial", "mass_kg", "velocity_m_s")
_CHAIN = (
    "Before a fit, state how well mass, velocity, gain and zero are known, by --uncertainty velocity=0.01 or "
    "in dataset.toml, where a table for it waits: else they count as exact, and intervals of K and C come "
    "out too narrow."
)
_TEMPLATE = """
# Standard deviations of the measuring chain. What is left out counts as exact. Give yours without the #.
# [uncertainty]
# relative_mass_sd = 0.002     # the balance: 0.2 % of the mass
# velocity_sd_m_s = 0.01       # m/s
# relative_gain_sd = 0.005     # the sensor's calibration: 0.5 %
# offset_sd = 0.1              # the sensor's zero, in m/s^2, or in m of a displacement
"""
_OPTIONS = {
    f"signal.{key}": f"--{option}"
    for key, option in (
        *(("quantity", "quantity"), ("unit", "unit"), ("time_unit", "time-unit"), ("scale", "scale")),
        *(("value_column", "channel"), ("time_column", "time"), ("offset", "offset")),
        *((key, f"text {key}") for key in TextSettings.model_fields),
        *(("crop", "crop"), ("gravity", "gravity"), ("zero", "zero")),
    )
}


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
    recordings: RecorderFolder,
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
        recordings: the files.
        facts: what is known of each.
        choices: with no question left.
        name: of the dataset.
        cutting: cut several impacts in one recording apart; otherwise every recording holds one.
        skip_bad: leave out what is wrong, instead of refusing the whole.

    Raises:
        InputError: everything that is wrong, with the files, with what is known of them, and with the dataset
            that they make.
    """
    problems = [*recordings.problems, *facts.problems]
    settings = _settings(choices, name, len(recordings.files))
    signal = _signal(settings, problems)
    rows = list(impact_rows(recordings, facts, choices, signal, cutting, problems))
    if not rows:
        raise InputError(problems)
    _write(folder, settings, rows, recordings)
    try:
        dataset = read_dataset(folder)
    except InputError as error:
        by_trace = {f"{RECORDINGS}/{file.name}": file for file in recordings.files}
        by_impact = {row["impact"]: by_trace[row["trace"]] for row in rows}
        wrong = [_in_terms_of_init(problem) for problem in error.problems]
        problems += (
            wrong
            if cutting
            else [_with_hint(problem, by_impact, signal, facts, choices) for problem in wrong]
        )
    if not problems:
        return Built(dataset, (), _notes(dataset, cutting))
    bad = {problem.impact for problem in problems}
    rows = [row for row in rows if row["impact"] not in bad]
    files = {file.name for file in recordings.files} | {problem.file for problem in recordings.problems}
    files |= {choices.table.name} if choices.table else set()
    if not skip_bad or not rows or any(p.impact is None and p.file not in files for p in problems):
        raise InputError(problems)
    shutil.rmtree(folder / RECORDINGS)
    _write(folder, settings, rows, recordings)
    dataset = read_dataset(folder)
    return Built(dataset, tuple(problems), _notes(dataset, cutting))


def _settings(choices: Choices, name: str, files: int) -> dict[str, Any]:
    names = f", names read as {choices.pattern}" if choices.pattern else ""
    tables = {"recorder": choices.recorder, "uncertainty": choices.uncertainty}
    stated = {key: table for key, table in tables.items() if table}
    return {
        "name": name,
        "source": f"bayestissue init, from {files} recorder file{'s' if files > 1 else ''}{names}",
        "signal": choices.signal(),
        **stated,
    }


def _signal(settings: dict[str, Any], problems: list[Problem]) -> SignalSettings:
    try:
        return parse_settings(settings).signal
    except InputError as error:
        options = [
            replace(p, file="init", column=_OPTIONS.get(column := p.column or "", _recorder_option(column)))
            for p in error.problems
        ]
        raise InputError([*problems, *options]) from None


def _recorder_option(key: str) -> str | None:
    """An entry of the table ``[recorder]`` as the option that gives it; others as they are."""
    table, _, name = key.partition(".")
    return f"--recorder {name}".strip() if table == "recorder" else key or None


def _write(
    folder: Path, settings: dict[str, Any], rows: list[dict[str, Any]], recordings: RecorderFolder
) -> None:
    table = pd.DataFrame(rows)
    order = dict.fromkeys([*(name for name in _FIRST if name in table), *table.columns])
    write_dataset(folder, settings=settings, impacts=table[list(order)])
    if "uncertainty" not in settings:
        with (folder / SETTINGS).open("a", encoding="utf-8") as settings_file:
            settings_file.write(_TEMPLATE)
    for file in recordings.files:
        copy = folder / RECORDINGS / file.name
        if f"{RECORDINGS}/{file.name}" in set(table["trace"]):
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file.path, copy)


def _in_terms_of_init(problem: Problem) -> Problem:
    """A problem of the dataset in the words of who has not seen it yet: their files, their options."""
    inside = f"{RECORDINGS}/"
    for key, option in _OPTIONS.items():
        remedy = problem.remedy.replace(f"as {key} in dataset.toml", f"by {option}")
        remedy = re.sub(rf"{re.escape(key)}\b( in dataset\.toml)?", option, remedy)
        problem = replace(problem, remedy=remedy)
    if problem.file.startswith(inside):
        return replace(problem, file=problem.file.removeprefix(inside))
    if problem.file == "impacts.csv":
        return replace(problem, file="impacts.csv as init would write it")
    return problem


def _with_hint(
    problem: Problem, files: dict[str, File], signal: SignalSettings, facts: Facts, choices: Choices
) -> Problem:
    """The problem with a further remedy where the recording seems to hold several impacts."""
    file = files.get(problem.impact or "")
    if file is None or problem.file != file.name:
        return problem
    try:
        count = len(cut(oriented(file, signal, stated_rate(facts.of_file[file.name], choices))))
    except InputError:
        return problem
    hint = f" The recording seems to hold {count} impacts: --several cuts them apart." if count > 1 else ""
    return replace(problem, remedy=problem.remedy + hint)


def _notes(dataset: Dataset, cutting: Cutting | None) -> tuple[str, ...]:
    notes = [] if any(asdict(dataset.uncertainty).values()) else [_CHAIN]
    if several := [] if cutting else _with_several(dataset):
        advice = "the impact with the highest peak is used; --several cuts them apart"
        notes.insert(0, f"{first_of(several, 5)}: the recording seems to hold several impacts; {advice}.")
    return tuple(notes)


def _with_several(dataset: Dataset) -> list[str]:
    sign = -1.0 if dataset.quantity == "acceleration" else 1.0
    oriented: Iterable[Trace] = (Trace(trace.time_s, sign * trace.value) for trace in dataset.traces)
    return [
        str(impact)
        for impact, trace in zip(dataset.impacts["impact"], oriented, strict=True)
        if len(cut(trace)) > 1
    ]
