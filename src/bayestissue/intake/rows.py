"""The rows of `impacts.csv`: an impact for each recording, or for each stretch of one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from bayestissue.dataset import Trace
from bayestissue.dataset.crop import COLUMNS as CROP
from bayestissue.dataset.samples import in_seconds
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.trace_files import read_one
from bayestissue.errors import InputError, Problem
from bayestissue.intake.choices import Choices
from bayestissue.intake.cutting import SEPARATION_S, THRESHOLD, cut
from bayestissue.intake.facts import Cells, Facts
from bayestissue.intake.folder import File, Found

RECORDINGS = "recordings"


@dataclass(frozen=True)
class Cutting:
    """How several impacts in one recording are told apart; see `cut`."""

    threshold: float = THRESHOLD
    separation_s: float = SEPARATION_S


def impact_rows(
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
    usual = _usual_units(found, choices)
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
            _require_unit(file, usual)
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
    trace = oriented(file, signal, stated_rate(facts.of_file[file.name], choices))
    if bad := int(np.count_nonzero(~np.isfinite(trace.value))):
        remedy = "Correct the recording, or read a stretch of it with --crop."
        raise InputError(
            Problem(
                file.name,
                "finite numbers",
                remedy,
                value=f"no number at {bad} of {trace.value.size} samples",
                code="not-a-number",
            )
        )
    first, last = _ends(signal)
    stretches = [
        (max(start, first), min(stop, last))
        for start, stop in cut(trace, threshold=cutting.threshold, separation_s=cutting.separation_s)
    ]
    numbers = [number for name, number in facts.of_number if name == file.name]
    if not stretches or (numbers and sorted(numbers) != list(range(1, len(stretches) + 1))):
        told = f"{len(numbers)} impacts, as many as the table has rows" if numbers else "at least one impact"
        raise InputError(
            Problem(
                file.name,
                told,
                "Change --threshold or --separation-s, or correct the table.",
                value=f"{len(stretches)} impacts",
                code="several-impacts",
            )
        )
    common = facts.of_file[file.name]
    return [
        (facts.of_number.get((file.name, number), common), stretch)
        for number, stretch in enumerate(stretches, 1)
    ]


def _usual_units(found: Found, choices: Choices) -> dict[str, str]:
    """The unit that most of the files state for the values, and for the times, by the channel."""
    units = {
        name: Counter(about.unit for about in every)
        for name, every in found.candidates().items()
        if name in (choices.channel, choices.time)
    }
    return {name: count.most_common(1)[0][0] for name, count in units.items()}


def _require_unit(file: File, usual: dict[str, str]) -> None:
    """Refuse a file whose channel has another unit than that of the others: one unit holds for a dataset."""
    problems = [
        Problem(
            file.name,
            f"the unit of the other recordings, {unit or 'which state none'}",
            "Export it in that unit, or make a dataset of its own of such files.",
            column=name,
            value=file.channels[name].unit or "no unit",
            code="mixed-units",
        )
        for name, unit in usual.items()
        if name in file.channels and file.channels[name].unit != unit
    ]
    if problems:
        raise InputError(problems)


def _require_one(file: File, facts: Facts) -> None:
    numbers = [number for name, number in facts.of_number if name == file.name]
    if len(numbers) > 1:
        remedy = "Add --several, so that the recording is cut apart."
        found = f"{len(numbers)} rows of the table"
        raise InputError(
            Problem(file.name, "one impact in the recording", remedy, value=found, code="several-impacts")
        )


def stated_rate(cells: Cells, choices: Choices) -> float:
    """The sampling rate that is stated of a recording, Hz; nan where none is."""
    return float(cells.get("sampling_rate_hz", choices.rate_hz or np.nan))


def oriented(file: File, signal: SignalSettings, rate: float) -> Trace:
    """A recording, as far as it is read, positive while the impactor slows or into the tissue."""
    time, value = read_one(file.path, file.name, signal, rate)
    value = -value if signal.quantity == "acceleration" else value
    start, stop = _ends(signal)
    inside = (time >= start) & (time <= stop)
    return Trace(time[inside], value[inside])


def _ends(signal: SignalSettings) -> tuple[float, float]:
    """From when to when recordings are read, s."""
    start, stop = in_seconds(np.array(signal.crop or [-np.inf, np.inf]), signal)
    return float(start), float(stop)
