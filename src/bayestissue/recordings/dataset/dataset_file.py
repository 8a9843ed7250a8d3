"""What `dataset.toml` may say, and what to answer when it says something else."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, LiteralString, Self, get_args

import numpy as np
from jaxtyping import Float64
from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from bayestissue.base.errors import InputError, Problem, has_control_characters
from bayestissue.base.literature import SITES
from bayestissue.base.settings import Argument, TomlTable, argument, checked, only, parse_toml, read_text
from bayestissue.recordings.dataset.dialect import Stated
from bayestissue.recordings.dataset.plausible import PLAUSIBLE
from bayestissue.recordings.dataset.units import EXAMPLES, Dimension, dimension_of, to_si

FILE = "dataset.toml"
STANDARD_GRAVITY = 9.80665
Quantity = Literal["deceleration", "acceleration", "displacement"]
ChannelQuantity = Literal["force"]
Contact = Literal["between", "on_sample"]
Place = Literal["impactor", "base"]
SaeClass = Literal[60, 180, 600, 1000]


# SAE J211-1, appendix C: a filter of two poles with its corner here, run forwards and backwards, has its
# -3 dB corner at 5/3 of the class, since (1 + 0.8022⁴)⁻¹ = 2^(-1/2) and 2.0775 × 0.8022 = 5/3.
SAE_CORNER = 2.0775
MOST_POLES = 8
# What each quantity is measured in.
DIMENSIONS: dict[str, Dimension] = {
    "deceleration": "acceleration", "acceleration": "acceleration", "displacement": "length",
}  # fmt: skip
# The same of a further channel.
CHANNEL_DIMENSIONS: dict[str, Dimension] = {"force": "force"}
# Keys that say how a channel stands in its files, and nothing of what was measured.
_OF_FILES = {
    *("unit", "scale", "offset", "limit", "zero", "crop", "file", "time_offset_s"),
    *("time_unit", "time_column", "value_column", *Stated.model_fields),
}
_GRAVITIES = {"none": 0.0, "drop": STANDARD_GRAVITY}


def _fraction(value: float) -> float:
    most = PLAUSIBLE.most_sd
    if value >= most:
        meant = f"; {value:g} %, if that is meant, is {value / 100:g}" if value < 100 * most else ""
        raise ValueError(f"a fraction below {most:g}{meant}")
    return value


def _measuring(unit: str, info: ValidationInfo) -> str:
    """A unit of time, or of the quantity; where that is not known, any."""
    of_quantity = (DIMENSIONS | CHANNEL_DIMENSIONS).get(info.data.get("quantity", ""))
    dimension = "time" if info.field_name == "time_unit" else of_quantity
    if dimension and dimension_of(unit, [dimension]) is None:
        key: LiteralString = "unit.channel" if dimension == "force" else "unit.unknown"
        raise PydanticCustomError(key, "{expected}", {"expected": EXAMPLES[dimension]})
    return unit


_ON_ONE_LINE = only(
    lambda text: text.strip() and not has_control_characters(text),
    "a name on one line, without control characters",
)
_TABLES = (".csv", ".csv.gz", ".xlsx", ".parquet")
Name = Annotated[str, Field(min_length=1)]
Unit = Annotated[Name, AfterValidator(_measuring)]
ShortName = Annotated[Name, Field(max_length=40), _ON_ONE_LINE]
Noun = Annotated[ShortName, only(lambda text: set(text).isdisjoint('<>&"'), 'a noun without < > & and "')]
TableName = Annotated[
    Name,
    only(
        lambda name: Path(name).name == name and name.endswith(_TABLES),
        "the name of a .csv, .csv.gz, .xlsx or .parquet file in the dataset's folder",
    ),
]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Factor = Annotated[Finite, only(bool, "a number other than 0")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Spread = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[Spread, AfterValidator(_fraction)]
OnEarth = Annotated[
    Finite,
    only(
        lambda value: abs(value) <= PLAUSIBLE.most_gravity,
        f"a number of m/s² from -{PLAUSIBLE.most_gravity:g} to {PLAUSIBLE.most_gravity:g}",
    ),
]
Gravity = Literal["none", "drop"] | OnEarth
Stretch = Annotated[
    tuple[float, ...],
    Field(strict=False),  # of TOML they are lists
    only(
        lambda ends: len(ends) == 2 and -math.inf < ends[0] < ends[1] < math.inf,
        "two numbers [start, stop], the first the smaller",
    ),
]
Zero = Literal["free_fall", "rest"]


def gravity_m_s2(gravity: Gravity) -> float:
    """The part of gravity along the motion, m/s²."""
    return _GRAVITIES[gravity] if isinstance(gravity, str) else gravity


class SignalSettings(Stated):
    """The table ``[signal]``: what was recorded and in which units.

    Attributes:
        quantity: what was recorded. deceleration: positive while the impactor slows. acceleration: the
            negative of that. displacement: into the tissue, positive.
        unit: the unit of the recorded values after scale and offset: m/s^2, g, mm, µm ...
        value_column: the column, channel or variable with the values. A recorder file of one channel needs no
            name.
        time_column: the column, channel or variable with the times.
        time_unit: the unit of the times: s, ms, µs ...
        scale: raw values are multiplied by it; not 0.
        offset: is added to them after that.
        limit: the sensor's range in that unit, on either side of its zero: samples there are taken as that or
            beyond. Left out, the greatest value that several recordings share is the limit, and a plateau in
            one of them.
        gravity: the part of gravity along the motion: none (a pendulum at its lowest point, a horizontal
            impact), drop (straight down), or a number of m/s², positive into the tissue.
        zero: where an accelerometer read 0: free_fall (it reads force over mass; so it does where a quiet
            part before contact was taken off), or rest.
        contact: where contact falls: between samples (a free-running recorder) or on_sample (a triggered
            recorder, a simulation from contact on). Left out, all recordings together tell; the velocity must
            be right for it. Behind a low-pass, and of displacements, it is not asked.
        crop: [start, stop]: the stretch of every recording that is read, in time_unit on the recorder's
            clock.
    """

    quantity: Quantity
    unit: Unit
    value_column: Name = "value"
    time_column: Name = "time_s"
    time_unit: Unit = "s"
    scale: Factor = 1.0
    offset: Finite = 0.0
    limit: Positive | None = None
    gravity: Gravity = "none"
    zero: Zero = "free_fall"
    contact: Contact | None = None
    crop: Stretch | None = None

    @property
    def dimension(self) -> Dimension:
        """What ``unit`` has to measure."""
        return (DIMENSIONS | CHANNEL_DIMENSIONS)[self.quantity]

    @property
    def gravity_m_s2(self) -> float:
        """The part of gravity along the motion, m/s²."""
        return gravity_m_s2(self.gravity)

    @property
    def below_force(self) -> float:
        """What a recorded value in m/s² is too small by, to be force over mass or its negative."""
        if self.zero == "free_fall" or self.quantity == "displacement":
            return 0.0
        return -self.gravity_m_s2 if self.quantity == "acceleration" else self.gravity_m_s2

    def in_si(self) -> Self:
        """The same of recordings in SI units, force over mass where there is gravity."""
        stated = {key: getattr(self, key) for key in self.model_fields_set - _OF_FILES}
        unit = "m" if self.dimension == "length" else "m/s^2"
        return type(self)(**stated | {"unit": unit, "gravity": self.gravity_m_s2 or "none"})

    @property
    def limits_si(self) -> tuple[float, float] | None:
        """What a value at the sensor's lower and upper limit is in m/s² or m; None where none is stated."""
        if self.limit is None:
            return None
        limit = self.limit * to_si(self.unit, self.dimension)
        return self.below_force - limit, self.below_force + limit


class LowPassFilter(TomlTable, strict=True):
    """The table ``[recorder]``: a known low-pass between the sensor and the file.

    Of an SAE class it has the corner, order, kind and direction that the class stands for.

    Attributes:
        low_pass_hz: the -3 dB corner of the filter run once, a number of Hz above 0
        kind: "butterworth" or "bessel"
        zero_phase: true where the filter is run forwards and backwards, else false
        sae_class: a channel frequency class of SAE J211-1, 60, 180, 600 or 1000, instead of the others
        noise: "before" where the noise went through the filter, "after" where it did not; left out, the quiet
            parts before contact tell
        applied: "digital" where software ran the filter over the samples of the file, "analog" where it acted
            before sampling (or on far more samples than the file has); left out, digital with zero_phase or
            sae_class, else analog
    """

    low_pass_hz: Positive = 0.0
    order: Annotated[int, Field(ge=1, le=MOST_POLES)] = Field(
        default=2, description=f"the number of the filter's poles, 1 to {MOST_POLES}"
    )
    kind: Literal["butterworth", "bessel"] = "butterworth"
    zero_phase: bool = False
    sae_class: SaeClass | None = None
    noise: Literal["before", "after"] | None = None
    applied: Literal["analog", "digital"] | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_class(cls, stated: Any) -> Any:
        if isinstance(stated, Mapping) and stated.get("sae_class") in get_args(SaeClass):
            return {**_meaning(stated["sae_class"]), **stated}
        return stated

    def contradictions(self) -> Iterator[str]:
        """A corner must be stated, once."""
        if not self.low_pass_hz:
            yield "low_pass_hz, or sae_class"
        if self.sae_class and any(getattr(self, k) != v for k, v in _meaning(self.sae_class).items()):
            yield "sae_class by itself, since it says corner, order, kind and direction"

    @model_serializer(mode="wrap")
    def _by_class(self, written: SerializerFunctionWrapHandler) -> dict[str, Any]:
        implied = _meaning(self.sae_class) if self.sae_class else {}
        return {key: value for key, value in written(self).items() if key not in implied}

    @property
    def digital(self) -> bool:
        """Whether it is a digital filter of the samples; one of zero phase can be no other unless stated."""
        return self.zero_phase if self.applied is None else self.applied == "digital"

    def __str__(self) -> str:
        stated = f", {self.applied}" if self.applied else ""
        stated += f", noise {self.noise} it" if self.noise else ""
        if self.sae_class is not None:
            return f"SAE class {self.sae_class}{stated}"
        directions = ", forwards and backwards" if self.zero_phase else ""
        return f"{self.kind}, order {self.order}, {self.low_pass_hz:g} Hz{directions}{stated}"


def _meaning(sae_class: int) -> dict[str, Any]:
    """The other keys of a low-pass of that class."""
    return {"low_pass_hz": SAE_CORNER * sae_class, "order": 2, "kind": "butterworth", "zero_phase": True}


class ChannelSettings(TomlTable, strict=True):
    """A table ``[[channel]]``: a further channel of the same impacts; ``[signal]`` is the first.

    Attributes:
        name: what pages and messages call it.
        quantity: what it recorded. force: positive while the impactor slows.
        place: where the sensor is: impactor (between the impactor and its tip), or base (below the tissue).
        unit: the unit of its values after scale and offset: N, kN ...
        file: a long table of its own in the dataset's folder, such as force.csv; left out, its values stand
            beside those of the first channel, in the same table or files.
        value_column: the column, channel or variable with its values; value in a file of its own.
        time_column: that with its times, where it is not the first channel's. Found if left out, where each
            channel's values stand behind times of their own.
        scale: raw values are multiplied by it; not 0.
        offset: is added to them after that.
        limit: the sensor's range in that unit, as signal.limit; samples there are left out.
        time_offset_s: is added to its times, in s: they are then those of the first channel's clock.
        relative_gain_sd: of its sensitivity, as a fraction of it, below 0.5; one for all impacts.
        tip_mass_kg: what of the mass in impacts.csv lies between an impactor's sensor and the tissue: the
            sensor reads the force on the rest.
        recorder: a table [channel.recorder] with the keys of [recorder]: the low-pass that this channel went
            through. That of the first channel does not hold for it.
    """

    name: ShortName
    quantity: ChannelQuantity
    place: Place
    unit: Unit
    file: TableName | None = None
    value_column: Name | None = None
    time_column: Name | None = None
    scale: Factor = 1.0
    offset: Finite = 0.0
    limit: Positive | None = None
    time_offset_s: Finite = 0.0
    relative_gain_sd: Fraction = 0.0
    tip_mass_kg: Spread = 0.0
    recorder: LowPassFilter | None = None

    def contradictions(self) -> Iterator[str]:
        """Its values must stand somewhere, and a tip be before its sensor."""
        if self.file is None and self.value_column is None:
            yield "value_column, or file, which say where its values are"
        if self.tip_mass_kg and self.place == "base":
            yield 'tip_mass_kg only beside place = "impactor"'

    def as_signal(self, first: SignalSettings) -> SignalSettings:
        """The settings by which its recordings are read: those of the first channel but for its own."""
        overrides: dict[str, Any] = {
            "quantity": self.quantity,
            "unit": self.unit,
            "value_column": self.value_column or SignalSettings.model_fields["value_column"].default,
            **{key: getattr(self, key) for key in ("scale", "offset", "limit")},
            "zero": "free_fall",
            **({"time_column": self.time_column} if self.time_column else {}),
        }
        return first.model_copy(update=overrides)

    def in_si(self) -> Self:
        """The same of recordings in SI units in a table of their own."""
        stated = {key: getattr(self, key) for key in self.model_fields_set - _OF_FILES}
        return type(self)(**stated | {"unit": "N", "file": f"{self.quantity}.csv.gz"})

    def __str__(self) -> str:
        behind = f", behind a tip of {self.tip_mass_kg:g} kg" if self.tip_mass_kg else ""
        filtered = f", {self.recorder}" if self.recorder else ""
        return f"{self.name}: {self.quantity} at the {self.place}{behind}{filtered}"


class Uncertainty(TomlTable, strict=True):
    """The table ``[uncertainty]``: standard deviations of the measuring chain, in SI units.

    Attributes:
        relative_mass_sd: of the mass, as a fraction of it, below 0.5: 0.05 is 5 %.
        velocity_sd_m_s: of the velocity at contact; below half the median velocity.
        relative_gain_sd: of the recorder's sensitivity, as a fraction of it, below 0.5.
        offset_sd: of the recorder's zero, in m/s² or, of displacements, in m; below half the median peak.
    """

    relative_mass_sd: Fraction = 0.0
    velocity_sd_m_s: Spread = 0.0
    relative_gain_sd: Fraction = 0.0
    offset_sd: Spread = 0.0

    def of_velocity(self, velocity: Float64[np.ndarray, " impact"]) -> Float64[np.ndarray, " impact"]:
        """Of the velocity at contact over the gain, as a fraction of it: what a trace is integrated with."""
        return np.hypot(self.velocity_sd_m_s / velocity, self.relative_gain_sd)


class ImpactorSettings(TomlTable, strict=True):
    """The table ``[impactor]``: what hits.

    Attributes:
        headform: true where the impactor stands for a head, as in EN 1177 and ASTM F1292: its impacts then
            have the head injury criterion too.
    """

    headform: bool = False


class WordSettings(TomlTable, strict=True):
    """The table ``[words]``: what pages, papers and messages call the units; without < > & and ".

    Attributes:
        subject: who or what is hit, such as "pad"; else person.
        subjects: of several; the other with an s, else.
        trial: a condition, such as "height"; else condition.
        trials: of several.
        impact: one impact, such as "drop"; else impact.
        impacts: of several.
    """

    subject: Noun | None = None
    subjects: Noun | None = None
    trial: Noun | None = None
    trials: Noun | None = None
    impact: Noun | None = None
    impacts: Noun | None = None

    def contradictions(self) -> Iterator[str]:
        """A plural must have its singular."""
        for key in ("subject", "trial", "impact"):
            if getattr(self, f"{key}s") is not None and getattr(self, key) is None:
                yield f"{key} beside {key}s"

    def values(self) -> dict[str, str]:
        """The nouns that are stated, by key."""
        return self.model_dump(exclude_none=True)


class Settings(TomlTable, strict=True):
    """The whole of ``dataset.toml``.

    Attributes:
        name: of the dataset, on one line.
        description: free text, shown on pages.
        licence: on what terms others may use it.
        source: where it comes from.
        signal: what was recorded and in which units.
        channel: a table [[channel]]: one further channel of the same impacts.
        uncertainty: standard deviations of the measuring chain; a fit carries each into its intervals.
        recorder: a table [recorder] with low_pass_hz, or with sae_class: a low-pass between sensor and file.
        impactor: what hits.
        words: what pages, papers and messages call the units of the study.
    """

    name: Annotated[Name, _ON_ONE_LINE]
    description: str = ""
    licence: str = ""
    source: str = ""
    site: Annotated[
        str,
        only(("", *SITES).__contains__, f"one of {', '.join(SITES)}, or no site where none of them was hit"),
    ] = Field(
        default="",
        description="what was hit, so that the report holds this study against published values of the same: "
        f"{'; '.join(f'{name}, {words}' for name, words in SITES.items())}. Left out, values of any site are "
        "shown whose mass and velocity compare.",
    )
    signal: SignalSettings
    channel: Annotated[
        tuple[ChannelSettings, ...],
        Field(strict=False),
        only(lambda channels: len(channels) < 2, "one table [[channel]]: a force beside the first channel"),
    ] = ()
    uncertainty: Uncertainty = Uncertainty()
    recorder: LowPassFilter | None = None
    impactor: ImpactorSettings = ImpactorSettings()
    words: WordSettings = WordSettings()

    def in_si(self) -> Self:
        """The same of recordings in SI units, as a `Dataset` has them."""
        channel = tuple(channel.in_si() for channel in self.channel)
        return self.model_copy(update={"signal": self.signal.in_si(), "channel": channel})

    def signal_of(self, channel: ChannelSettings | None) -> tuple[SignalSettings, SignalSettings | None]:
        """By what a channel is read; and, where it stands beside the first one, by what that is."""
        if channel is None:
            return self.signal, None
        return channel.as_signal(self.signal), None if channel.file else self.signal

    def stated(self) -> dict[str, Any]:
        """The keys that are stated, tables as nested dictionaries, as `settings_text` writes them."""
        return self.model_dump(exclude_unset=True, exclude_none=True)

    @property
    def needs_velocity(self) -> bool:
        """Whether every impact must state its velocity at contact."""
        return self.signal.quantity != "displacement"

    def contradictions(self) -> Iterator[str]:
        """A low-pass must be of decelerations."""
        if self.recorder is not None and self.signal.quantity == "displacement":
            yield "no table [recorder] beside displacements, whose likelihoods have no place for a low-pass"


_TABLED: dict[str, type[TomlTable]] = {"signal": SignalSettings, "impactor": ImpactorSettings}
# What an argument or an option states, by where it stands, as ``signal.unit``: not how texts are written, nor
# further channels.
_KEYS = {
    f"{table}.{key}": field
    for table, schema in _TABLED.items()
    for key, field in schema.model_fields.items()
    if key not in Stated.model_fields
} | {key: field for key, field in Settings.model_fields.items() if key not in (*_TABLED, "channel")}
# By the name of the argument that states it: where a key stands.
PLACES = {key.rpartition(".")[2]: key for key in _KEYS}


def arguments() -> dict[str, Argument]:
    """The argument of each of `PLACES`, with what it means."""
    return {name: argument(_KEYS[key]) for name, key in PLACES.items()}


def content_of(stated: Mapping[str, Any], places: Mapping[str, str] = PLACES) -> dict[str, Any]:
    """The content of ``dataset.toml`` that arguments state, by their names; None states nothing."""
    content: dict[str, Any] = {}
    for name, value in stated.items():
        *table, key = places[name].split(".")
        if value is not None:
            (content.setdefault(table[0], {}) if table else content)[key] = plain_value(value)
    return content


def plain_value(value: Any) -> Any:
    """The value as Python's own; what is none is left for the settings to refuse."""
    if isinstance(value, TomlTable):
        return value.model_dump(exclude_unset=True)
    if isinstance(value, Mapping):
        return {str(key): plain_value(inner) for key, inner in value.items()}
    return value.tolist() if hasattr(value, "tolist") else value


def reworded(problem: Problem, files: Mapping[str, str], names: Mapping[str, str]) -> Problem:
    """The problem in the words of somebody who has no such file.

    Args:
        problem: as the files of a dataset have it.
        files: what these are called otherwise, of which it may be.
        names: of keys and files in its sentences, and what is said instead.
    """
    expected, remedy, column = problem.expected, problem.remedy, problem.column or ""
    for name, other in names.items():
        expected, remedy, column = (text.replace(name, other) for text in (expected, remedy, column))
    file = files.get(problem.file, problem.file)
    return replace(problem, file=file, expected=expected, remedy=remedy, column=column or None)


def read_settings(path: Path) -> Settings:
    """Read and check ``dataset.toml``.

    Raises:
        InputError: the file is missing, is no TOML, or has unknown, missing or wrong entries; all at once.
    """
    if not path.exists():
        raise InputError.stated("no-dataset.settings", FILE, value="no file of that name")
    text = read_text(path, FILE)
    return parse_settings(parse_toml(text, FILE), text)


def parse_settings(raw: dict[str, Any], text: str = "") -> Settings:
    """Check settings that are already a dictionary.

    Args:
        raw: the keys of ``dataset.toml``, tables as nested dictionaries.
        text: the file they came from, to find the rows of what is wrong.

    Raises:
        InputError: every unknown, missing or wrong entry.
    """
    return checked(raw, Settings, file=FILE, text=text)
