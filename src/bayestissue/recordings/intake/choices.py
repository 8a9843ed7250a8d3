"""What has to be known before a folder becomes a dataset, what the files themselves say, and what to ask."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import Field

from bayestissue.base.declarations import sentences
from bayestissue.base.errors import InputError, Problem, refuse
from bayestissue.base.settings import Argument, TomlTable, argument, checked
from bayestissue.recordings.dataset.cells import is_height
from bayestissue.recordings.dataset.dataset_file import DIMENSIONS, arguments, content_of, plain_value
from bayestissue.recordings.dataset.dataset_file import PLACES as KEYS
from bayestissue.recordings.dataset.impact_table import WITHIN, in_two_levels
from bayestissue.recordings.dataset.ragged_traces import MIN_SAMPLES, RATE_WITHIN
from bayestissue.recordings.dataset.recorders import TIME
from bayestissue.recordings.dataset.units import EXAMPLES, Dimension, dimension_of, to_si
from bayestissue.recordings.intake.facts import Facts
from bayestissue.recordings.intake.folder import Candidates, ChannelSummary, RecorderFile, RecorderFolder

_VOLTS = {"V", "mV", "Volt", "Volts", "volt", "volts"}
_TIME = re.compile(rf"{TIME}\b|time_|seconds_elapsed", re.IGNORECASE)
said = sentences(__package__)
# What impacts.csv needs, with an example.
_NEEDED = {"subject": "s01", "mass_kg": "2.1", "velocity_m_s": "1.5"}
# What a force can stand beside, and names of channels of a sensor below the tissue.
BESIDE_FORCE = ("deceleration", "acceleration")
_BELOW = re.compile(r"base|plate|platform|floor|ground|below", re.IGNORECASE)
_SHOWN = 8


@dataclass(frozen=True)
class Cutting:
    """How several impacts in one recording are told apart; see `bayestissue.recordings.intake.build.cut`.

    Attributes:
        threshold: standard deviations of the noise that an impact rises above,
        share: and this share of the greatest peak: the handling of the impactor between two stays below it.
        separation_s: the least time between two impacts.
        before, after: of the separation: enough rest to learn the noise and the zero from.
        digits: of the times, s: no recorder's clock is read finer than nanoseconds.
    """

    threshold: float = 20.0
    separation_s: float = 0.5
    share: float = 0.1
    before: float = 0.1
    after: float = 0.5
    digits: int = 9


# Keys of ``dataset.toml`` that an option states under another name, and where the key of each option stands.
_NAMES = {"value_column": "channel", "time_column": "time"}
PLACES = {_NAMES.get(name, name): key for name, key in KEYS.items() if name != "source"}


class Choices(TomlTable):
    """What is known of a folder of recorder files besides the files.

    Attributes:
        keys: of ``dataset.toml``, by their options.
        beside: the table ``[[channel]]`` of the force beside the motion; empty without one.
        pattern: how file names are read, such as "{subject}_{side}_{mass_kg}kg_{n}.lvm"; guessed from the
            names unless given. A name in braces is a column of impacts.csv; {} is what does not matter.
            mass_g, velocity_cm_s, drop_height_m, _cm and _mm are converted (v = sqrt(2 g h), for a pendulum
            too). {subject:group} counts anew in each group. With / the folders above the file are read as
            well.
        table: a table with a column file, the name of a recording, and a column for each fact; with a column
            number too, a row for each impact of a recording. Without file it is joined by the columns that
            names have too, such as subject.
        given: facts that hold for all recordings.
        rate_hz: the sampling rate, where there are no times.
        text: how text files are written, where that is not found rightly: encoding (utf-8, utf-16, cp1252),
            delimiter (comma, semicolon, tab, pipe, space), decimal (point, comma), thousands (none, point,
            comma, space, apostrophe), header_row, units_row.
        force: entries of the table [[channel]] of a force beside the motion: value_column, place (impactor or
            base), unit, scale, tip_mass_kg, relative_gain_sd, time_column, time_offset_s. The only channel
            with a unit of force is taken unless given; none leaves it out.
        several: cut several impacts in one recording apart.
        threshold: standard deviations of the noise that an impact rises above.
        separation_s: the least time between two impacts, s.
        skip_bad: leave out what is wrong, and say so, instead of refusing the whole.
    """

    keys: dict[str, Any] = Field(default={})
    beside: dict[str, Any] = Field(default={})
    pattern: str | None = None
    table: Path | None = None
    given: dict[str, str] = Field(default={})
    rate_hz: Annotated[float, Field(ge=0)] | None = None
    text: dict[str, Any] = Field(default={})
    force: dict[str, Any] | Literal["none"] = Field(default={})
    several: bool = False
    threshold: Annotated[float, Field(ge=1)] = Cutting.threshold
    separation_s: Annotated[float, Field(ge=0.001)] = Cutting.separation_s
    skip_bad: bool = False

    def stating(self, **options: Any) -> Choices:
        """The same with these options too; None states nothing."""
        options = {name: value for name, value in options.items() if value is not None}
        keys = {name: options.pop(name) for name in PLACES if name in options}
        return self.model_copy(update={"keys": self.keys | keys, **options})

    def stated(self, option: str) -> Any:
        """What an option states; None where it does not."""
        return self.keys.get(option)

    def content(self, source: str) -> dict[str, Any]:
        """What ``dataset.toml`` says of these recordings, which come from the ``source``."""
        content = content_of({option: value for option, value in self.keys.items() if value != {}}, PLACES)
        content["signal"] = content.get("signal", {}) | self.text
        names = f", names read as {self.pattern}" if self.pattern else ""
        channel = {"channel": [self.beside]} if self.beside else {}
        return content | channel | {"source": source + names}


def options() -> dict[str, Argument]:
    """What `choices_of` takes, with what it means: see `bayestissue.base.declarations.taking`."""
    further = (name for name in Choices.model_fields if name not in ("keys", "beside"))
    others = {name: argument(Choices.model_fields[name]) for name in further}
    of_keys = {_NAMES.get(name, name): declared for name, declared in arguments().items()}
    # What is left out is not stated.
    stated = {name: (of_keys[name][0].replace(default=None), of_keys[name][1]) for name in PLACES}
    return stated | others


def choices_of(**stated: Any) -> Choices:
    """The choices of options by their names.

    Raises:
        InputError: one has a value of another kind.
    """
    stated = {name: plain_value(value) for name, value in stated.items() if value is not None}
    others = {name: stated.pop(name) for name in Choices.model_fields if name in stated}
    others["given"] = {name: str(value) for name, value in others.get("given", {}).items()}
    return checked(others, Choices, file="init").stating(**stated)


@dataclass(frozen=True)
class MissingFact:
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
            return choices.stating(given={**choices.given, name: text})
        name = self.option.removeprefix("--").replace("-", "_")
        try:
            return choices.stating(**{name: float(text) if name == "rate_hz" else text})
        except ValueError:
            raise InputError.stated("option-value.rate", self.option, value=text) from None


def settle(
    choices: Choices, recordings: RecorderFolder, facts: frozenset[str]
) -> tuple[Choices, list[MissingFact]]:
    """Fill in what the files themselves leave no doubt about; what is left are questions.

    The channel is the only one that is no time and whose unit can be right; times are a channel that goes up,
    and is named for it or has a unit of time; units are those that all files state for a channel. Of a name
    its beginning is enough where no other begins so.

    Args:
        choices: so far.
        recordings: the files.
        facts: the columns of ``impacts.csv`` that names, a table and options fill.
    """
    channels = recordings.candidates()
    for option in ("channel", "time"):
        choices = choices.stating(**{option: _in_full(choices.stated(option), channels)})
    values = _values_among(channels, choices.stated("time"))
    if not values:
        raise InputError(_no_values(file, len(recordings.files)) for file in recordings.files)
    for option in ("channel", "time"):
        if (name := choices.stated(option)) is not None and name not in channels:
            names = ", ".join(channels)
            raise InputError.stated("no-channel.option", f"--{option}", value=name, names=names)
    force = _force_channel(choices, recordings)
    choices, questions = _answered(choices, "channel", _one_of(values, "channel"))
    named = choices.stated("channel")
    chosen = channels[named] if named else [channel for name in values for channel in channels[name]]
    rated = choices.rate_hz is not None or "sampling_rate_hz" in facts
    if not rated and not all(channel.clock for channel in chosen):
        choices, missing = _answered(choices, "time", _time(channels, named))
        questions += missing
    if (time := choices.stated("time")) is not None and choices.stated("time_unit") is None:
        choices = choices.stating(time_unit=_unit(channels[time], ["time"]))
    choices, missing = _measured(choices, chosen)
    questions += [*missing, *_facts_wanted(choices, facts, several=len(recordings.files) > 1)]
    return choices.stating(beside=force if choices.stated("quantity") in BESIDE_FORCE else {}), questions


def _answered(choices: Choices, option: str, answer: str | MissingFact) -> tuple[Choices, list[MissingFact]]:
    """The choices with an option that is not stated as the files have it, or the question for it."""
    if choices.stated(option) is not None:
        return choices, []
    if isinstance(answer, MissingFact):
        return choices, [answer]
    return choices.stating(**{option: answer}), []


def _measured(choices: Choices, chosen: Sequence[ChannelSummary]) -> tuple[Choices, list[MissingFact]]:
    """The same of the quantity and of its unit, which say something of one another."""
    unit, quantity = choices.stated("unit"), choices.stated("quantity")
    units = {unit} if unit else {channel.unit for channel in chosen}
    kind = _stated_kind(choices, units)
    possible = [name for name in DIMENSIONS if kind not in DIMENSIONS.values() or DIMENSIONS[name] == kind]
    if unit is None and quantity in DIMENSIONS and quantity not in possible:
        can_be = {"unit": ", ".join(sorted(units)), "possible": " or ".join(possible)}
        raise InputError.stated("option-value.quantity", "--quantity", value=quantity, **can_be)
    choices, questions = _answered(choices, "quantity", _one_of(possible, "quantity"))
    quantity = choices.stated("quantity")
    dimensions = list(dict.fromkeys(DIMENSIONS[name] for name in possible))
    if quantity is not None:
        dimensions = [DIMENSIONS.get(quantity, "acceleration")]
    if unit is not None:
        return choices, questions
    of_files = _unit(chosen, dimensions)
    if of_files is None:
        questions.append(_which_unit(units, kind, dimensions))
    elif choices.stated("channel") is not None and quantity is not None:
        choices = choices.stating(unit=of_files)
    return choices, questions


def _facts_wanted(choices: Choices, facts: frozenset[str], *, several: bool) -> Iterator[MissingFact]:
    """What neither names nor a table nor options say of each recording; ``several`` are there."""
    optional = ["velocity_m_s"] if choices.stated("quantity") == "displacement" else []
    for name, example in _NEEDED.items():
        if name == "subject" and choices.table is not None and several and name not in facts:
            # One name for all of the people of a table is nobody's answer.
            yield MissingFact("--pattern", said("questions.pattern"), (), "{subject}_{n}")
        elif name not in facts and name not in optional:
            yield MissingFact(f"--set {name}=", said(f"questions.{name}"), (), example)
    if choices.stated("gravity") is None and any(map(is_height, facts)):
        yield _asked_of(["drop", "none"], "gravity")


def people_twice(pattern: str | None, facts: Facts) -> list[MissingFact]:
    """Whether a person in several levels of what tells people apart is one, by the pattern that says so."""
    if pattern is None or "{subject}" not in pattern:
        return []
    rows = pd.DataFrame(facts.of_file.values())
    for name, person, levels in in_two_levels(rows) if "subject" in rows else ():
        if f"{{{name}}}" not in pattern:
            continue
        one = pattern.replace(f"{{{name}}}", next(f"{{{w}}}" for w in WITHIN if f"{{{w}}}" not in pattern))
        two = pattern.replace("{subject}", f"{{subject:{name}}}")
        what = said("questions.person", person=person, levels=" and in ".join(levels))
        return [MissingFact("--pattern", what, (one, two), two)]
    return []


def _one_of(answers: Sequence[str], option: str) -> str | MissingFact:
    """The only answer that is possible, or the question which of them it is."""
    return answers[0] if len(answers) == 1 else _asked_of(answers, option)


def _asked_of(answers: Sequence[str], option: str) -> MissingFact:
    return MissingFact(f"--{option}", said(f"questions.{option}"), tuple(answers), answers[0])


def _values_among(channels: Candidates, time: str | None) -> list[str]:
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


def _rising_among(channels: Candidates) -> list[str]:
    """The names of those whose values rise evenly in every file, as times do."""
    return [name for name, files in channels.items() if all(one.steps and one.steps.rises for one in files)]


def _time(channels: Candidates, channel: str | None) -> str | MissingFact:
    """The channel with the times; else the question which it is, or for a rate where none can be.

    Of several, each in front of values of its own, the last one before those of the channel.
    """
    if times := times_among(channels):
        names = list(channels)
        before = [name for name in names[: names.index(channel)] if name in times] if channel else []
        if before and not any(one in times and other in times for one, other in pairwise(names)):
            return before[-1]
        return _one_of(times, "time")
    if rising := _rising_among(channels):
        return _asked_of(rising, "time")
    return MissingFact("--rate-hz", said("questions.rate_hz"), (), "10000")


def _stated_kind(choices: Choices, units: set[str]) -> str:
    """What the units say of the quantity, as `_kind_of`; empty where they say nothing of it."""
    # A scale makes another unit of the one that the files state, and of several channels one is to be chosen.
    if not choices.stated("unit") and abs(choices.stated("scale") or 1) != 1:
        return ""
    kind = _kind_of(units)
    return "" if kind == "other" and choices.stated("channel") is None else kind


def _which_unit(units: set[str], kind: str, dimensions: Sequence[Dimension]) -> MissingFact:
    """The question for the unit of the values, and for a scale where the files state volts or the like."""
    to_scale, stated = kind in ("other", "voltage"), ", ".join(sorted(filter(None, units)))
    example = "mm" if dimensions == ["length"] else "m/s^2" if to_scale else "g"
    examples = " or ".join(EXAMPLES[dimension] for dimension in dimensions)
    what = said("questions.scaled_unit" if to_scale else "questions.unit", stated=stated, examples=examples)
    return MissingFact("--unit", what, (), example)


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
    force = choices.force
    if force == "none" or choices.stated("quantity") not in (None, *BESIDE_FORCE):
        return {}
    candidates = recordings.candidates()
    forces = [name for name in forces_among(recordings) if name != choices.stated("channel")]
    name = _in_full(force.get("value_column"), candidates)
    if name is None and len(forces) == 1:
        name = forces[0]
    if name not in candidates:
        if not force:
            return {}
        value = name or "no value_column"
        raise InputError.stated("no-channel.option", "--force", value=value, names=", ".join(candidates))
    location = "base" if _BELOW.search(name) else "impactor"
    defaults = {"name": "force", "quantity": "force", "place": location}
    unit = _unit(candidates[name], ["force"])
    return defaults | ({"unit": unit} if unit else {}) | force | {"value_column": name}


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


def times_among(channels: Candidates) -> list[str]:
    """The names of those that go up in every file, and are named for times or have a unit of time."""
    return [
        name
        for name, summaries in channels.items()
        if all(channel.steps for channel in summaries) and (_TIME.match(name) or _unit(summaries, ["time"]))
    ]


def require_steady(file: RecorderFile, rate: float) -> None:
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


def _no_values(file: RecorderFile, files: int) -> Problem:
    value = f"{', '.join(file.channels) or 'no numbers'} ({file.written or file.source.suffix})"
    return replace(Problem.stated("no-channel.values", file.name, value=value), files_read=files)


def _unit(channels: Sequence[ChannelSummary], dimensions: Sequence[Dimension]) -> str | None:
    """The unit that every file states for a channel, if it measures what it should."""
    unit, *others = {channel.unit for channel in channels}
    return unit if not others and dimension_of(unit, dimensions) else None
