"""What is simulated: ranges of tissue, measuring chain and every cause's strength, from a TOML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayestissue.dataset.settings import Finite
from bayestissue.declarations import declared
from bayestissue.errors import InputError, Problem
from bayestissue.settings import Table, checked, parse_toml, read_text
from bayestissue.thesis.causes.settings import SETTINGS

Name = Annotated[str, Field(pattern="^[A-Za-z0-9_]+$")]


class Range(Table):
    """A uniform distribution from ``low`` to ``high``, of the logarithm where ``log`` is true.

    Attributes:
        low: the smallest value.
        high: the greatest value.
        log: whether the logarithm is uniform.
    """

    low: Finite
    high: Finite
    log: bool = False

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low > self.high:
            raise ValueError("low not above high")
        if self.log and self.low <= 0:
            raise ValueError("low above 0, since the logarithm is uniform")
        return self

    def draw(self, random: np.random.Generator, count: int) -> np.ndarray:
        """``count`` independent values."""
        share = random.uniform(size=count)
        if self.log:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share


class Sizes(Table):
    """How many campaigns.

    Attributes:
        each: campaigns of every cause.
        batch: campaigns that are simulated together; another number gives other draws.
    """

    each: Annotated[int, Field(ge=SETTINGS.fewest_campaigns)] = 1000
    batch: Annotated[int, Field(ge=1, le=500)] = 50


class TissuePrior(Table):
    """The typical person's tissue at the reference mass, and how it differs between people and impacts.

    The damping ratio stands for C = 2 zeta sqrt(K M_ref); standard deviations are of log K and log C.

    Attributes:
        K_N_per_m: stiffness of the typical person.
        zeta: damping ratio, which stands for C = 2 zeta sqrt(K M) at the reference mass.
        sd_subject_K: standard deviation of log K between people.
        sd_subject_C: standard deviation of log C between people.
        sd_impact_K: standard deviation of log K between impacts.
        sd_impact_C: standard deviation of log C between impacts.
    """

    K_N_per_m: Range
    zeta: Range
    sd_subject_K: Range
    sd_subject_C: Range
    sd_impact_K: Range
    sd_impact_C: Range


class RecordingPrior(Table):
    """The measuring chain; the peak is each impact's greatest deceleration.

    Attributes:
        samples_to_peak: samples from contact to the greatest deceleration.
        noise_relative_to_peak: standard deviation of the noise as a fraction of the peak.
        offset_relative_to_peak_sd: standard deviation of the recorder's zero as a fraction of the peak.
        gain: recorded over true deceleration, one number for a campaign.
        relative_velocity_sd: standard deviation of the velocity at contact as a fraction of it.
    """

    samples_to_peak: Range
    noise_relative_to_peak: Range
    offset_relative_to_peak_sd: Range
    gain: Range
    relative_velocity_sd: Range


Mechanism = Literal[
    "none",
    "centring",
    "conversion",
    "fixed window",
    "own time",
    "velocity",
    "active",
    "stiffening",
    "wall",
    "maxwell",
    "standard linear",
    "moving mass",
]
MECHANISMS = declared(__package__, "mechanisms.toml")
# The strengths that each mechanism reads from the file.
STRENGTHS = {name: tuple(entry["strengths"]) for name, entry in MECHANISMS.items()}
Driver = Literal["mass", "energy", "momentum"]


class Cause(Table):
    """One proposed cause: what acts, how strongly, and what it is called on the page.

    Attributes:
        mechanism: what acts.
        words: what the page calls the cause.
        driver: what people react to. Of the mechanism active alone.
        after_the_fact: whether it was proposed by people who had seen what it is to explain.
        strength: how strongly the mechanism acts: a range for each of its strengths, by name.
    """

    mechanism: Mechanism
    words: Annotated[str, Field(min_length=1)]
    driver: Driver | None = None
    after_the_fact: bool = False
    strength: dict[str, Range] = Field(default={})

    @model_validator(mode="after")
    def _strengths(self) -> Self:
        wanted = STRENGTHS[self.mechanism]
        if set(self.strength) != set(wanted):
            named = ", ".join(wanted) or "none"
            raise ValueError(f"for the mechanism {self.mechanism!r} these strengths: {named}")
        if (self.driver is not None) != (self.mechanism == "active"):
            raise ValueError("a driver for the mechanism 'active', and for no other")
        return self


class CausesSpecification(Table):
    """A whole specification of `bayestissue causes`.

    Attributes:
        campaigns: how many campaigns are simulated.
        tissue: the typical person's tissue, and how it differs between people and impacts.
        recording: the measuring chain.
        causes: the proposed causes, by name.
    """

    campaigns: Sizes = Sizes()
    tissue: TissuePrior
    recording: RecordingPrior
    causes: Annotated[dict[Name, Cause], Field(min_length=2)]


def read_causes(path: Path) -> CausesSpecification:
    """Read and check a specification.

    Raises:
        InputError: the file can't be read, or holds keys or values that are not allowed; all are named.
    """
    text = read_text(path, str(path))
    return checked(parse_toml(text, str(path)), CausesSpecification, file=str(path), text=text)


def chosen(specification: CausesSpecification, names: tuple[str, ...], file: str) -> CausesSpecification:
    """The specification with only the causes of these names, all of them if there is none.

    Raises:
        InputError: a name is not one of the file's causes.
    """
    if not names:
        return specification
    unknown = [name for name in names if name not in specification.causes]
    if unknown:
        known = ", ".join(specification.causes)
        raise InputError(
            Problem.stated("option-value.cause", file, column="causes", value=name, known=known)
            for name in unknown
        )
    causes = {name: specification.causes[name] for name in names}
    return specification.model_copy(update={"causes": causes})


def require_several(specification: CausesSpecification, file: str) -> None:
    """Raise an `InputError` where fewer than two causes are left to compare."""
    if len(specification.causes) < 2:
        named = ", ".join(specification.causes) or "none"
        raise InputError.stated("option-value.causes", file, column="causes", value=named)
