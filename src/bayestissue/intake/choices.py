"""What has to be known before a folder becomes a dataset, what the files themselves say, and what to ask."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from bayestissue.dataset.impacts import WITHIN, in_two_levels
from bayestissue.dataset.settings import DIMENSIONS
from bayestissue.dataset.traces import MIN_SAMPLES, RATE_WITHIN
from bayestissue.dataset.units import EXAMPLES, Dimension, dimension_of, to_si
from bayestissue.errors import InputError, Problem, refuse
from bayestissue.intake.facts import Facts
from bayestissue.intake.folder import ChannelSummary, File, RecorderFolder
from bayestissue.intake.names import is_height

_VOLTS = {"V", "mV", "Volt", "Volts", "volt", "volts"}
_TIME = re.compile(
    r"(time|timestamp|elapsed|zeit|uhrzeit|temps|tiempo|tempo|t)\b|time_|seconds_elapsed", re.IGNORECASE
)
# What impacts.csv needs: what it is, and an example.
_NEEDED = {
    "subject": ("who was hit", "s01"),
    "mass_kg": ("mass of the impactor, kg", "2.1"),
    "velocity_m_s": ("velocity at contact, m/s, or drop_height_m instead", "1.5"),
}
_FALLS = (
    "how it moves at contact: straight down (drop), or across gravity, as a pendulum at its lowest point "
    "does (none)"
)
# What a force can stand beside, and names of channels of a sensor below the tissue.
BESIDE_FORCE = ("deceleration", "acceleration")
_BELOW = re.compile(r"base|plate|platform|floor|ground|below", re.IGNORECASE)
_SHOWN = 8
_ALIKE = "for all recordings alike, or of each by --pattern or --table"


@dataclass(frozen=True)
class Choices:
    """What the user said; None where nothing was.

    Attributes:
        channel: the channel with the recorded values.
        quantity: ``"deceleration"``, ``"acceleration"`` or ``"displacement"``.
        unit: of the values.
        time: the channel with the times, where the format carries none.
        time_unit: its unit.
        rate_hz: the sampling rate, where there is neither.
        scale: by which raw values are multiplied.
        offset: added after that.
        crop: the stretch of every recording that is read, in the unit of time; whole if None.
        pattern: how file names are read.
        table: a table of facts.
        shared: facts that hold for all recordings, as text.
        recorder: the table ``[recorder]`` of ``dataset.toml``; none if empty.
        uncertainty: the table ``[uncertainty]`` of ``dataset.toml``; none if empty.
        text: how texts are written, as far as it is not to be found: keys of `Stated`.
        gravity: the part of gravity along the motion, as ``signal.gravity``.
        zero: where the sensor read 0, as ``signal.zero``.
        contact: where contact falls within a sampling interval, as ``signal.contact``.
        force: entries of the table ``[[channel]]`` of a force beside the motion; "none" for none. The
            only channel with a unit of force is taken where nothing is said.
        force_channel: the whole of that table, as `settle` has it; empty without a force.
    """

    channel: str | None = None
    quantity: str | None = None
    unit: str | None = None
    time: str | None = None
    time_unit: str | None = None
    rate_hz: float | None = None
    scale: float = 1.0
    offset: float = 0.0
    crop: tuple[float, float] | None = None
    pattern: str | None = None
    table: Path | None = None
    shared: dict[str, str] = field(default_factory=dict)
    recorder: dict[str, Any] = field(default_factory=dict)
    text: dict[str, Any] = field(default_factory=dict)
    gravity: str | float | None = None
    zero: str | None = None
    contact: str | None = None
    uncertainty: dict[str, Any] = field(default_factory=dict)
    force: dict[str, Any] | Literal["none"] = field(default_factory=dict)
    force_channel: dict[str, Any] = field(default_factory=dict)

    def signal(self) -> dict[str, Any]:
        """The table ``[signal]`` of ``dataset.toml``."""
        said = {
            "quantity": self.quantity,
            "unit": self.unit,
            "value_column": self.channel,
            "time_column": self.time,
            "time_unit": self.time_unit,
            "scale": self.scale if self.scale != 1 else None,
            "offset": self.offset or None,
            "gravity": self.gravity,
            "zero": self.zero,
            "contact": self.contact,
            "crop": None if self.crop is None else list(self.crop),
            **self.text,
        }
        return {key: value for key, value in said.items() if value is not None}


@dataclass(frozen=True)
class Question:
    """Something that nothing says so far.

    Attributes:
        option: that answers it, such as ``--channel`` or ``--set mass_kg=``.
        what: is asked for, as it follows "expected".
        answers: those that are possible; empty where any text may be one.
        example: an answer, for the line that a message shows.
    """

    option: str
    what: str
    answers: tuple[str, ...]
    example: str

    @property
    def wording(self) -> str:
        """What is asked for, with the answers that are possible."""
        more = f" or one of {len(self.answers) - _SHOWN} more" if len(self.answers) > _SHOWN else ""
        return self.what + (f": {' or '.join(self.answers[:_SHOWN])}{more}" if self.answers else "")

    @property
    def line(self) -> str:
        """The option as it is typed, with the example."""
        space = "" if self.option.endswith("=") else " "
        example = f'"{self.example}"' if re.search(r"[^\w./^%=-]", self.example) else self.example
        return f"{self.option}{space}{example}"

    def answer(self, choices: Choices, text: str) -> Choices:
        """The choices with this question answered.

        Raises:
            InputError: the answer should be a number, and is none.
        """
        if self.option.startswith("--set"):
            name = self.option.removeprefix("--set ").removesuffix("=")
            return replace(choices, shared={**choices.shared, name: text})
        name = self.option.removeprefix("--").replace("-", "_")
        if name != "rate_hz":
            said: dict[str, Any] = {name: text}
            return replace(choices, **said)
        try:
            return replace(choices, rate_hz=float(text))
        except ValueError:
            raise InputError.stated("option-value.rate", self.option, value=text) from None


_OF_TABLE = Question(
    "--pattern",
    "who was hit: name a column of the table subject, or say where names of files have it",
    (),
    "{subject}_{n}",
)


def settle(
    choices: Choices, recordings: RecorderFolder, facts: frozenset[str]
) -> tuple[Choices, list[Question]]:
    """Fill in what the files themselves leave no doubt about; what is left are questions.

    The channel is the only one that is no time and whose unit can be right; times are a channel that goes up,
    and is named for it or has a unit of time; units are those that all files state for a channel. Of a name
    its beginning is enough where no other begins so.

    Args:
        choices: so far.
        recordings: the files.
        facts: the columns of ``impacts.csv`` that names, a table and options fill.
    """
    questions: list[Question] = []

    def take(name: str, answer: str | Question) -> None:
        nonlocal choices
        if isinstance(answer, Question):
            questions.append(answer)
        else:
            settled: dict[str, Any] = {name: answer}
            choices = replace(choices, **settled)

    channels = recordings.candidates()
    choices = replace(
        choices, channel=_in_full(choices.channel, channels), time=_in_full(choices.time, channels)
    )
    values = _values_among(channels, choices.time)
    if not values:
        raise InputError(_no_values(file, len(recordings.files)) for file in recordings.files)
    for option, name in (("--channel", choices.channel), ("--time", choices.time)):
        if name is not None and name not in channels:
            raise InputError.stated("no-channel.option", option, value=name, names=", ".join(channels))
    if choices.channel is None:
        take("channel", _one_of(values, "--channel", "the channel with the impact"))
    chosen = [channel for name in values for channel in channels[name]]
    if choices.channel is not None:
        chosen = channels[choices.channel]

    rated = choices.rate_hz is not None or "sampling_rate_hz" in facts
    if choices.time is None and not rated and not all(channel.clock for channel in chosen):
        take("time", _time(channels, choices.channel))
    if choices.time is not None and choices.time_unit is None:
        choices = replace(choices, time_unit=_unit(channels[choices.time], ["time"]))

    units = {choices.unit} if choices.unit else {channel.unit for channel in chosen}
    kind = _stated_kind(choices, units)
    possible = [name for name in DIMENSIONS if kind not in DIMENSIONS.values() or DIMENSIONS[name] == kind]
    force = _force_channel(choices, recordings)
    if choices.quantity is None:
        what = "what it recorded (a deceleration is positive while the impactor slows)"
        take("quantity", _one_of(possible, "--quantity", what))
    elif choices.unit is None and choices.quantity in DIMENSIONS and choices.quantity not in possible:
        can_be = {"unit": ", ".join(sorted(units)), "possible": " or ".join(possible)}
        raise InputError.stated("option-value.quantity", "--quantity", value=choices.quantity, **can_be)

    dimensions = list(dict.fromkeys(DIMENSIONS[name] for name in possible))
    if choices.quantity is not None:
        dimensions = [DIMENSIONS.get(choices.quantity, "acceleration")]
    unit = _unit(chosen, dimensions)
    if choices.unit is None and unit is None:
        questions.append(_which_unit(units, kind, dimensions))
    elif choices.unit is None and choices.channel is not None and choices.quantity is not None:
        choices = replace(choices, unit=unit)

    optional = ["velocity_m_s"] if choices.quantity == "displacement" else []
    questions += [
        Question(f"--set {name}=", f"{what}, {_ALIKE}", (), example)
        for name, (what, example) in _NEEDED.items()
        if name not in facts and name not in optional
    ]
    if choices.table is not None and len(recordings.files) > 1:
        # One name for all of the people of a table is nobody's answer.
        questions = [_OF_TABLE if q.option == "--set subject=" else q for q in questions]
    if choices.gravity is None and any(map(is_height, facts)):
        questions.append(Question("--gravity", _FALLS, ("drop", "none"), "drop"))
    return replace(choices, force_channel=force if choices.quantity in BESIDE_FORCE else {}), questions


def people_twice(pattern: str | None, facts: Facts) -> list[Question]:
    """Whether a person in several levels of what tells people apart is one, by the pattern that says so."""
    if pattern is None or "{subject}" not in pattern:
        return []
    rows = pd.DataFrame(facts.of_file.values())
    for name, person, levels in in_two_levels(rows) if "subject" in rows else ():
        if f"{{{name}}}" not in pattern:
            continue
        one = pattern.replace(f"{{{name}}}", next(f"{{{w}}}" for w in WITHIN if f"{{{w}}}" not in pattern))
        two = pattern.replace("{subject}", f"{{subject:{name}}}")
        what = f"{person} is in {' and in '.join(levels)}: one person or two? In this order"
        return [Question("--pattern", what, (one, two), two)]
    return []


def _one_of(answers: Sequence[str], option: str, what: str) -> str | Question:
    """The only answer that is possible, or the question which of them it is."""
    return answers[0] if len(answers) == 1 else Question(option, what, tuple(answers), answers[0])


def _values_among(channels: Mapping[str, Sequence[ChannelSummary]], time: str | None) -> list[str]:
    """The names of those that may hold the impact: no times, long enough, and of a unit that can be right."""
    times, rising = times_among(channels), _rising_among(channels)
    # What rises evenly is hardly an impact, whatever it is called.
    no_impacts = {*times, *rising, time} if times or len(rising) == 1 else {time}
    kinds = {
        name: _kind_of(channel.unit for channel in summaries)
        for name, summaries in channels.items()
        if name not in no_impacts and max(channel.samples for channel in summaries) >= MIN_SAMPLES
    }
    # Volts may be any quantity; where a unit is right, a force or a temperature is none.
    known = {"acceleration", "length"} & set(kinds.values())
    return [name for name, kind in kinds.items() if not (known and kind == "other")]


def _rising_among(channels: Mapping[str, Sequence[ChannelSummary]]) -> list[str]:
    """The names of those whose values never fall."""
    return [name for name, summaries in channels.items() if all(channel.rising for channel in summaries)]


def _time(channels: Mapping[str, Sequence[ChannelSummary]], channel: str | None) -> str | Question:
    """The channel with the times; else the question which it is, or for a rate where none can be.

    Of several, each in front of values of its own, the last one before those of the channel.
    """
    if times := times_among(channels):
        names = list(channels)
        before = [name for name in names[: names.index(channel)] if name in times] if channel else []
        if before and not any(one in times and other in times for one, other in pairwise(names)):
            return before[-1]
        return _one_of(times, "--time", "the channel with the times")
    if rising := _rising_among(channels):
        return Question("--time", "the channel with the times", tuple(rising), rising[0])
    return Question("--rate-hz", "the sampling rate in Hz", (), "10000")


def _stated_kind(choices: Choices, units: set[str]) -> str:
    """What the units say of the quantity, as `_kind_of`; empty where they say nothing of it."""
    # A scale makes another unit of the one that the files state, and of several channels one is to be chosen.
    if not choices.unit and abs(choices.scale) != 1:
        return ""
    kind = _kind_of(units)
    return "" if kind == "other" and choices.channel is None else kind


def _which_unit(units: set[str], kind: str, dimensions: Sequence[Dimension]) -> Question:
    """The question for the unit of the values, and for a scale where the files state volts or the like."""
    remark, example = "", "mm" if dimensions == ["length"] else "g"
    if kind in ("other", "voltage"):
        stated = ", ".join(sorted(unit for unit in units if unit))
        remark = f" (the files state {stated}: give --scale too, by what {stated} is turned into it)"
        example = "mm" if dimensions == ["length"] else "m/s^2"
    examples = " or ".join(EXAMPLES[dimension] for dimension in dimensions)
    return Question("--unit", f"its unit after scale and offset{remark}, {examples}", (), example)


def forces_among(recordings: RecorderFolder) -> list[str]:
    """The names of the channels that have a unit of force in every file."""
    return [
        name
        for name, channels in recordings.candidates().items()
        if len(channels) == len(recordings.files)
        and min(channel.samples for channel in channels) >= MIN_SAMPLES
        and _unit(channels, ["force"])
    ]


def _force_channel(choices: Choices, recordings: RecorderFolder) -> dict[str, Any]:
    """The table ``[[channel]]`` of a force beside the motion, by its unit or as was said."""
    said = choices.force
    if said == "none" or choices.quantity not in (None, *BESIDE_FORCE):
        return {}
    candidates = recordings.candidates()
    forces = [name for name in forces_among(recordings) if name != choices.channel]
    name = _in_full(said.get("value_column"), candidates)
    if name is None and len(forces) == 1:
        name = forces[0]
    if name not in candidates:
        if not said:
            return {}
        value = name or "no value_column"
        raise InputError.stated("no-channel.option", "--force", value=value, names=", ".join(candidates))
    place = "base" if _BELOW.search(name) else "impactor"
    defaults = {"name": "force", "quantity": "force", "place": place}
    unit = _unit(candidates[name], ["force"])
    return defaults | ({"unit": unit} if unit else {}) | said | {"value_column": name}


def _in_full(name: str | None, names: Collection[str]) -> str | None:
    """The one of ``names`` that begins so, in capitals or small; as it is where none or several do."""
    if name is None or name in names:
        return name
    matches = [candidate for candidate in names if candidate.casefold().startswith(name.casefold())]
    return matches[0] if len(matches) == 1 and name else name


def _kind_of(units: Iterable[str]) -> str:
    """Of which dimension units are: "acceleration", "length", "voltage", "other"; empty where one lacks."""
    units = set(units)
    if "" in units:
        return ""
    kind, *others = {dimension_of(unit, ("acceleration", "length")) for unit in units}
    return kind if kind and not others else "voltage" if units <= _VOLTS else "other"


def times_among(channels: Mapping[str, Sequence[ChannelSummary]]) -> list[str]:
    """The names of those that go up in every file, and are named for times or have a unit of time."""
    return [
        name
        for name, summaries in channels.items()
        if all(channel.steps for channel in summaries) and (_TIME.match(name) or _unit(summaries, ["time"]))
    ]


def require_steady(file: File, rate: float) -> None:
    """Refuse a stated sampling rate (Hz) that the times in a file contradict, or by which samples are lost.

    Times may be as coarse as a recorder writes them: several samples may have the same.
    """
    problems = []
    for name in times_among({name: [channel] for name, channel in file.channels.items()}):
        channel = file.channels[name]
        steps, unit = channel.steps, _unit([channel], ["time"])
        if steps is None:
            continue
        if steps.gap is not None:
            words = f"a step of {steps.longest:.6g} where most are {steps.usual:.6g}"
            problems.append(Problem.stated("sampling-rate.gap", file.name, steps.gap, name, words, name=name))
            continue
        # The ends of a span are as coarse as its steps.
        within = RATE_WITHIN + steps.usual / (steps.mean * channel.samples)
        measured = None if unit is None else 1 / (steps.mean * to_si(unit, "time"))
        if measured is not None and abs(measured / rate - 1) > within:
            where = file.name, None, name, f"{measured:.4g} Hz"
            problems.append(Problem.stated("sampling-rate.option", *where, rate=rate, name=name))
    refuse(problems)


def _no_values(file: File, files: int) -> Problem:
    value = f"{', '.join(file.channels) or 'no numbers'} ({file.written or file.suffix})"
    return replace(Problem.stated("no-channel.values", file.name, value=value), files_read=files)


def _unit(channels: Sequence[ChannelSummary], dimensions: Sequence[Dimension]) -> str | None:
    """The unit that every file states for a channel, if it measures what it should."""
    unit, *others = {channel.unit for channel in channels}
    return unit if not others and dimension_of(unit, dimensions) else None
