"""The specification of a simulated campaign, as a TOML file says it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial, reduce
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import BeforeValidator, Field

from bayestissue.base import runtime
from bayestissue.base.settings import TomlTable, checked, only, read_toml
from bayestissue.model.hierarchy.formulas.group_terms import MASS_TERM, GroupTerm
from bayestissue.model.hierarchy.priors import term_of_group, term_of_slope
from bayestissue.model.hierarchy.specification import GainError
from bayestissue.recordings.dataset.dataset_file import (
    Contact,
    Finite,
    Gravity,
    LowPassFilter,
    Name,
    Place,
    Positive,
    Spread,
)

Count = Annotated[int, Field(ge=1)]
RelativeSd = Annotated[float, Field(ge=0, lt=0.3)]
_NUMBERS = ("mass_kg", "velocity_m_s", "energy_J")
_COLUMNS = ("impact", "subject", "trial", *_NUMBERS, "sampling_rate_hz", "diameter_m", "trace")


class Condition(TomlTable):
    """One experimental condition; of energy, velocity and mass two are given, since E = ½MV².

    Attributes:
        trial: the name of the condition.
        mass_kg: of the impactor.
        velocity_m_s: at contact.
        energy_J: at contact, E = ½MV². Two of mass, velocity and energy are given.
        diameter_m: of the impactor, for the element hunt_crossley.
    """

    trial: Name
    mass_kg: Positive | None = None
    velocity_m_s: Positive | None = None
    energy_J: Positive | None = None
    diameter_m: Positive | None = None

    def contradictions(self) -> Iterator[str]:
        """Two of the three are given."""
        if sum(value is None for value in (self.mass_kg, self.velocity_m_s, self.energy_J)) != 1:
            yield "two of mass_kg, velocity_m_s and energy_J, as the third follows from E = ½MV²"

    def mass_and_velocity(self) -> tuple[float, float]:
        """M in kg and V in m/s."""
        energy, velocity = self.energy_J or 0.0, self.velocity_m_s
        mass = self.mass_kg or 2 * energy / (velocity or 1.0) ** 2
        return mass, velocity or float(np.sqrt(2 * energy / mass))


def _counted(levels: Any) -> Any:
    return [str(number + 1) for number in range(levels)] if type(levels) is int else levels


# In a table of impacts an empty cell is no category.
Levels = Annotated[
    tuple[str, ...],
    Field(min_length=2),
    BeforeValidator(_counted),
    only(
        lambda levels: all(level.strip() for level in levels) and len(set(levels)) == len(levels),
        "levels with a name each, no two alike",
    ),
]


class Factor(TomlTable):
    """A further column of the impacts, such as the side that is hit or the session.

    Attributes:
        name: the name of the column.
        levels: their names, or how many there are.
        every: every person in every condition at every level; else each impact at one, drawn at random, all
            levels about equally often.
    """

    name: Annotated[Name, only(lambda name: name not in _COLUMNS, f"another name than {', '.join(_COLUMNS)}")]
    levels: Levels
    every: bool = True


class StudyDesign(TomlTable):
    """Who is hit how: every person in every condition, as often as ``repeats`` says.

    Attributes:
        conditions: a list of [[design.conditions]]; without it the nine conditions of the thesis's tables
            5.10 and 5.11, with the masses printed there.
        subjects: how many people.
        factors: a list of [[design.factors]]: further columns, such as side or session.
        repeats: impacts of each person in each condition.
    """

    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] | None = None
    subjects: Count = 10
    factors: tuple[Factor, ...] = ()
    repeats: Count = 1

    def contradictions(self) -> Iterator[str]:
        """Factors and trials have names of their own."""
        factors, trials = self.factors, [condition.trial for condition in self.conditions or ()]
        for what, names in (("factor", [factor.name for factor in factors]), ("trial", trials)):
            if len(set(names)) < len(names):
                yield f"a different name of each {what}"


class Spreads(TomlTable, extra="allow"):
    """Standard deviations of log K, log C and the logs of the element's further parameters, by name.

    Attributes:
        K: of log K.
        C: of log C.
    """

    __pydantic_extra__: dict[str, Spread] = Field(init=False)

    K: Spread = 0.0
    C: Spread = 0.0


class Tissue(TomlTable):
    """An element, Kelvin-Voigt unless said: a typical person's K and C, and how they vary.

    K and C are at the reference mass:
    log K = log K_N_per_m + mass_exponent_K log(M / reference_mass_kg) + subject + trial + impact effect,
    each effect normal with the standard deviation given; the same for C.

    Attributes:
        K_N_per_m: stiffness of a typical person at the reference mass.
        C_N_s_per_m: damping of a typical person at the reference mass.
        reference_mass_kg: the mass that K and C are stated at.
        mass_exponent_K: slope of log K on log mass.
        mass_exponent_C: slope of log C on log mass.
        sd_subject_K: standard deviation of log K between people.
        sd_subject_C: standard deviation of log C between people.
        sd_trial_K: standard deviation of log K between conditions.
        sd_trial_C: standard deviation of log C between conditions.
        sd_impact_K: standard deviation of log K between the impacts of one person in one condition.
        sd_impact_C: standard deviation of log C between the impacts of one person in one condition.
        sd_group: standard deviations of further group terms by their names, as in
            [tissue.sd_group."subject:side"].
        sd_slope: standard deviations of slopes between levels, as in
            [tissue.sd_slope."log(mass_kg)|subject"]: of the mass exponent, or of the slope on another column,
            taken from its mean.
        correlation: of the effects on K with those on C.
        element: what the impactor meets, as in a model file.
        parameters: the element's parameters besides K and C, by name.
        sd_impact_parameters: standard deviation of their logs between impacts.
    """

    K_N_per_m: Positive
    C_N_s_per_m: Positive
    reference_mass_kg: Positive = 0.7
    mass_exponent_K: Finite = 0.0
    mass_exponent_C: Finite = 0.0
    sd_subject_K: Spread = 0.0
    sd_subject_C: Spread = 0.0
    sd_trial_K: Spread = 0.0
    sd_trial_C: Spread = 0.0
    sd_impact_K: Spread = 0.0
    sd_impact_C: Spread = 0.0
    sd_group: dict[str, Spreads] = Field(default_factory=dict)
    sd_slope: dict[str, Spreads] = Field(default_factory=dict)
    correlation: Annotated[float, Field(ge=-1, le=1)] = 0.0
    element: str = "kelvin_voigt"
    parameters: dict[str, Positive] = Field(default_factory=dict)
    sd_impact_parameters: Spread = 0.0

    def spreads(self) -> dict[GroupTerm, Spreads]:
        """The further group terms and their spreads."""
        groups = {term_of_group(key): pair for key, pair in self.sd_group.items()}
        return groups | {term_of_slope(key): pair for key, pair in self.sd_slope.items()}

    def contradictions(self) -> Iterator[str]:
        """There is such an element, and it has these parameters."""
        from bayestissue.mechanics.elements import element, element_names

        if self.element not in element_names():
            yield f"an element of {', '.join(element_names())}"
        extra = {parameter.name for parameter in element(self.element).extra}
        if set(self.parameters) != extra:
            yield f"parameters with the keys {', '.join(sorted(extra)) or 'none'}"
        named_parameters = {name for spreads in self.spreads().values() for name, _ in spreads}
        if strange := sorted(named_parameters - {"K", "C", *extra}):
            allowed = ", ".join(["K", "C", *sorted(extra)])
            yield f"sd_group and sd_slope with the keys {allowed}, without {', '.join(strange)}"


class RecordedForce(TomlTable):
    """A force that is recorded beside the deceleration, at the same samples.

    A low-pass of the decelerations is not one of the force, whose own acts before its gain and limit.

    Attributes:
        place: as of a [[channel]] of dataset.toml: impactor, or base (below the tissue).
        tip_mass_kg: of the true mass, what lies between an impactor's sensor and the tissue.
        noise_sd_N: standard deviation of its noise.
        noise_relative_to_peak: the same as a fraction of the force's peak; variances add up.
        offset_sd_N: standard deviation of its zero, another in every impact.
        relative_gain_sd: standard deviation of its sensitivity, as a fraction of it; one for all impacts.
        limit_N: the sensor clips beyond this, either way; left out, it does not.
        recorder: a table [recording.force.recorder] with the keys of [recorder]: the force's own low-pass.
            Noise enters as it says there.
    """

    place: Place = "impactor"
    tip_mass_kg: Spread = 0.0
    noise_sd_N: Spread = 0.0
    noise_relative_to_peak: Spread = 0.0
    offset_sd_N: Spread = 0.0
    relative_gain_sd: RelativeSd = 0.0
    limit_N: Positive | None = None
    recorder: LowPassFilter | None = None


class RecordedDeceleration(TomlTable):
    """The measuring chain. Standard deviations of 0 and an absent ``bits`` mean a perfect one.

    What is recorded of mass and velocity is the design's; the true values scatter about it. The recorder
    samples at a phase of its own, so that contact falls anywhere within a sampling interval, unless it is
    triggered.

    Attributes:
        sampling_rate_hz: samples in a second.
        before_contact_s: how long before contact a recording begins.
        contact: between samples, anywhere, or on_sample: at a sample in every recording, which then holds the
            jump of the force.
        after_contact_s: how long it goes on after the tissue has stopped pushing.
        noise_sd_m_s2: standard deviation of the noise.
        noise_relative_to_peak: the same as a fraction of the impact's peak; variances add up.
        offset_sd_m_s2: standard deviation of the recorder's zero.
        relative_gain_sd: standard deviation of the sensitivity, as a fraction of it.
        gain_error: all: the sensitivity errs by one factor in all impacts. impact: in each by another.
        velocity_sd_m_s: standard deviation of the velocity at contact about the stated one.
        relative_mass_sd: standard deviation of the mass about the stated one, as a fraction of it, below 0.3.
        mass_factor: what all stated masses are to be multiplied by: 1.1 makes them 10 % too small.
        range_m_s2: the recorder clips beyond this, either way; left out, it does not.
        bits: the range has 2 to this power steps; left out, it has none.
    """

    sampling_rate_hz: Positive = 10_000.0
    before_contact_s: Spread = 0.01
    contact: Contact = "between"
    after_contact_s: Spread = 0.01
    noise_sd_m_s2: Spread = 0.0
    noise_relative_to_peak: Spread = 0.0
    offset_sd_m_s2: Spread = 0.0
    relative_gain_sd: RelativeSd = 0.0
    gain_error: GainError = "all"
    velocity_sd_m_s: Spread = 0.0
    relative_mass_sd: RelativeSd = 0.0
    mass_factor: Positive = 1.0
    range_m_s2: Positive | None = None
    bits: Annotated[int, Field(ge=6, le=32)] | None = None

    def contradictions(self) -> Iterator[str]:
        """Bits are of a range."""
        if self.bits is not None and self.range_m_s2 is None:
            yield "range_m_s2 beside bits, since the steps divide the range"

    def unfit_for(self, recorder: LowPassFilter | None) -> Iterator[str]:
        """A digital low-pass has its corner below half of the sampling rate."""
        most = self.sampling_rate_hz / 2
        if recorder and recorder.digital and recorder.low_pass_hz >= most:
            yield (
                f'a digital low-pass below {most:g} Hz, half of the sampling rate, or applied = "analog", '
                f"beside its corner of {recorder.low_pass_hz:g} Hz"
            )


class Recording(RecordedDeceleration):
    """The measuring chain. Standard deviations of 0 and an absent ``bits`` mean a perfect one.

    What is recorded of mass and velocity is the design's; the true values scatter about it. The recorder
    samples at a phase of its own, so that contact falls anywhere within a sampling interval, unless it is
    triggered.

    Attributes:
        force: a table [recording.force]: a force beside the deceleration.
    """

    force: RecordedForce | None = None


class Output(TomlTable):
    """The trace file.

    Attributes:
        traces: the format of the table of samples.
        float32: values in single precision; of parquet alone.
        decimals: decimals of the recorded m/s²; all digits unless given.
    """

    traces: Literal["csv", "csv.gz", "parquet"] = "csv.gz"
    float32: bool = False
    decimals: Annotated[int, Field(ge=0, le=15)] | None = None

    def contradictions(self) -> Iterator[str]:
        """Single precision is of parquet."""
        if self.float32 and self.traces != "parquet":
            yield 'traces = "parquet" beside float32, since text has no precision of its own'


class Phantom(TomlTable):
    """A spring of known stiffness, hit in every condition as people are; a linear one with a damper.

    Attributes:
        K_N_per_m: its stiffness.
        sd_N_per_m: how well that is known: what `impacts.csv` states is drawn with this standard deviation.
        C_N_s_per_m: its damping.
        repeats: impacts in each condition.
    """

    K_N_per_m: Positive
    sd_N_per_m: Positive
    C_N_s_per_m: Positive
    repeats: Count = 1


class Simulation(TomlTable):
    """A whole specification.

    Attributes:
        name: of the dataset.
        description: free text.
        seed: same seed, same machine: same numbers.
        design: who is hit how.
        tissue: a typical person's K and C, and how they vary.
        phantom: a table [phantom]: a spring of known stiffness beside the people.
        recording: the measuring chain.
        gravity: the part of gravity along the motion, as signal.gravity of dataset.toml: none, drop, or a
            number of m/s². What is recorded is force over mass, 0 in free fall.
        headform: whether the impactor stands for a head, as impactor.headform of dataset.toml.
        recorder: a table [recorder] as in dataset.toml: a low-pass between the sensor and the file. Noise of
            the stated size enters behind it, and with noise = "before" goes through it.
        output: the trace file.
    """

    name: Name
    description: str = ""
    seed: Annotated[int, Field(ge=0, le=runtime.MOST_SEED)] = 0
    design: StudyDesign = StudyDesign()
    tissue: Tissue
    phantom: Phantom | None = None
    recording: Recording = Recording()
    gravity: Gravity = "none"
    headform: bool = False
    recorder: LowPassFilter | None = None
    output: Output = Output()

    def contradictions(self) -> Iterator[str]:
        """Filters have samples enough, a fit one reference, and group terms columns that there are."""
        force = self.recording.force
        for recorder in (self.recorder, None if force is None else force.recorder):
            yield from self.recording.unfit_for(recorder)
        if self.phantom and force:
            yield "[phantom] or [recording.force], not both: a fit can use one of them"
        known = ("subject", "trial", *(factor.name for factor in self.design.factors))
        strange = {name for term in self.tissue.spreads() for name in term.factors if name not in known}
        if strange:
            yield (
                f"tissue.sd_group and tissue.sd_slope of levels of {', '.join(known)}, without "
                f"{', '.join(sorted(strange))}; further columns are [[design.factors]]"
            )
        slopes = {term.slope for term in self.tissue.spreads()} - {"", MASS_TERM, *_NUMBERS}
        if slopes:
            yield (
                f"tissue.sd_slope on {', '.join((MASS_TERM, *_NUMBERS))}, without {', '.join(sorted(slopes))}"
            )

    def conditions(self) -> pd.DataFrame:
        """One row per condition: ``trial``, ``mass_kg``, ``velocity_m_s``."""
        if self.design.conditions is None:
            return published_conditions()
        rows = [(*one.mass_and_velocity(), one.trial, one.diameter_m) for one in self.design.conditions]
        table = pd.DataFrame(rows, columns=["mass_kg", "velocity_m_s", "trial", "diameter_m"])
        return table.dropna(axis="columns")


def crossed(*tables: pd.DataFrame, repeats: int) -> pd.DataFrame:
    """Every row of each table with every one of the others, the last varying fastest, each so often."""
    combined = reduce(partial(pd.merge, how="cross"), tables)
    return combined.loc[combined.index.repeat(repeats)]


def published_conditions() -> pd.DataFrame:
    """The nine conditions of the thesis (table 5.10): ``trial``, ``mass_kg``, ``velocity_m_s``."""
    from bayestissue.recordings.dataset.published import read_published

    averages = read_published().averages
    rows = averages[averages["quantity"] == "K"].sort_values("trial")
    names = [f"t{trial:02d}" for trial in rows["trial"]]
    return rows[["mass_kg", "velocity_m_s"]].reset_index(drop=True).assign(trial=names)


def read_simulation(path: Path) -> Simulation:
    """Read and check a specification.

    Raises:
        InputError: the file can't be read, or holds keys or values that are not allowed; all are named.
    """
    return checked(read_toml(path), Simulation, file=str(path))
