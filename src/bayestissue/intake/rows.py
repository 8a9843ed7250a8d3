"""The rows of `impacts.csv`: an impact for each recording, or for each stretch that one is cut into."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from bayestissue.dataset import Trace
from bayestissue.dataset.recordings import CROP, in_seconds
from bayestissue.dataset.settings import SignalSettings
from bayestissue.dataset.traces import read_one
from bayestissue.errors import InputError, Problem, collected
from bayestissue.intake.choices import Choices
from bayestissue.intake.facts import Cells, Facts
from bayestissue.intake.folder import File, RecorderFolder
from bayestissue.signal.traces import noise_sd, stack

THRESHOLD, SEPARATION_S = 20.0, 0.5
# Of the greatest peak: the handling of the impactor between two impacts stays below it.
_SHARE = 0.1
# Of the separation, before and after an impact: enough rest to learn the noise and the zero from.
_BEFORE, _AFTER = 0.1, 0.5
_FEWEST = 8
# Nanoseconds: no recorder's clock is read finer.
_DIGITS = 9


def cut(
    trace: Trace, *, threshold: float = THRESHOLD, separation_s: float = SEPARATION_S
) -> list[tuple[float, float]]:
    """When each impact of a recording begins and ends, in order, s on the recorder's clock.

    Samples that rise above the median by more than ``threshold`` standard deviations of the noise, and by
    more than a tenth of the highest, belong to impacts. Two of them that lie at least ``separation_s`` apart
    belong to two impacts. An impact is cut out from a tenth of that time before its first such sample to half
    of it after its last one, so that no two stretches meet. The noise is the greater of the white noise that
    third differences show and the scatter about the median (the median absolute deviation over 0.6745).

    Args:
        trace: positive while the impactor slows, or into the tissue.
        threshold: in standard deviations of the noise.
        separation_s: the least time between two impacts; a rebound that follows sooner stays with its impact.

    Returns:
        One stretch for each impact; none where nothing rises above the noise.
    """
    value, time = trace.value, trace.time_s
    if value.size < _FEWEST or not (np.isfinite(value).all() and np.isfinite(time).all()):
        return []
    above = value - np.median(value)
    noise = max(float(noise_sd(stack([trace]))[0]), float(np.median(np.abs(above))) / 0.6745)
    moments = time[above > max(threshold * noise, _SHARE * above.max())]
    if not moments.size:
        return []
    gap = np.flatnonzero(np.diff(moments) >= separation_s)
    starts, ends = np.append(moments[:1], moments[gap + 1]), np.append(moments[gap], moments[-1:])
    return list(
        zip(
            (starts - _BEFORE * separation_s).round(_DIGITS).tolist(),
            (ends + _AFTER * separation_s).round(_DIGITS).tolist(),
            strict=True,
        )
    )


RECORDINGS = "recordings"


@dataclass(frozen=True)
class Cutting:
    """How several impacts in one recording are told apart; see `cut`."""

    threshold: float = THRESHOLD
    separation_s: float = SEPARATION_S


def impact_rows(
    recordings: RecorderFolder,
    facts: Facts,
    choices: Choices,
    signal: SignalSettings,
    cutting: Cutting | None,
    problems: list[Problem],
) -> Iterator[dict[str, Any]]:
    """The rows of ``impacts.csv``; what is wrong with a file goes to ``problems``."""
    bare = {file.name: file.name[: -len(file.suffix)] for file in recordings.files}
    short = Counter(PurePosixPath(name).name for name in bare.values())
    usual = _usual_units(recordings, choices)
    for file in recordings.files:
        if file.name not in facts.of_file:
            continue
        short_name = PurePosixPath(bare[file.name]).name
        base: dict[str, Any] = {
            "impact": short_name if short[short_name] == 1 else bare[file.name],
            "trace": f"{RECORDINGS}/{file.name}",
        }
        if choices.rate_hz is not None:
            base["sampling_rate_hz"] = choices.rate_hz
        with collected(problems):
            _require_unit(file, usual)
            if cutting is None:
                _require_one(file, facts)
                yield {**base, **facts.of_file[file.name]}
            else:
                for number, (cells, stretch) in enumerate(_pieces(file, facts, signal, cutting, choices), 1):
                    impact = f"{cells.get('impact', base['impact'])}-{number}"
                    yield {**base, **cells, "impact": impact, **dict(zip(CROP, stretch, strict=True))}


def _pieces(
    file: File, facts: Facts, signal: SignalSettings, cutting: Cutting, choices: Choices
) -> list[tuple[Cells, tuple[float, float]]]:
    trace = oriented(file, signal, stated_rate(facts.of_file[file.name], choices))
    if bad := int(np.count_nonzero(~np.isfinite(trace.value))):
        raise InputError.stated(
            "not-a-number.recording", file.name, value=f"no number at {bad} of {trace.value.size} samples"
        )
    first, last = _ends(signal)
    stretches = [
        (max(start, first), min(stop, last))
        for start, stop in cut(trace, threshold=cutting.threshold, separation_s=cutting.separation_s)
    ]
    numbers = [number for name, number in facts.of_number if name == file.name]
    if not stretches or (numbers and sorted(numbers) != list(range(1, len(stretches) + 1))):
        key = "several-impacts.table" if numbers else "several-impacts.none"
        raise InputError.stated(key, file.name, value=f"{len(stretches)} impacts", count=len(numbers))
    common = facts.of_file[file.name]
    return [
        (facts.of_number.get((file.name, number), common), stretch)
        for number, stretch in enumerate(stretches, 1)
    ]


def _usual_units(recordings: RecorderFolder, choices: Choices) -> dict[str, str]:
    """The unit that most of the files state for the values, and for the times, by the channel."""
    units = {
        name: Counter(channel.unit for channel in channels)
        for name, channels in recordings.candidates().items()
        if name in (choices.channel, choices.time)
    }
    return {name: count.most_common(1)[0][0] for name, count in units.items()}


def _require_unit(file: File, usual: dict[str, str]) -> None:
    """Refuse a file whose channel has another unit than that of the others: one unit holds for a dataset."""
    problems = [
        Problem.stated(
            "mixed-units",
            file.name,
            column=name,
            value=file.channels[name].unit or "no unit",
            unit=unit or "which state none",
        )
        for name, unit in usual.items()
        if name in file.channels and file.channels[name].unit != unit
    ]
    if problems:
        raise InputError(problems)


def _require_one(file: File, facts: Facts) -> None:
    numbers = [number for name, number in facts.of_number if name == file.name]
    if len(numbers) > 1:
        count = f"{len(numbers)} rows of the table"
        raise InputError.stated("several-impacts.one", file.name, value=count)


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
    """The times from which and to which recordings are read, s."""
    start, stop = in_seconds(np.array(signal.crop or [-np.inf, np.inf]), signal)
    return float(start), float(stop)
