"""The plan file: which designs are compared, for which questions, and what is believed beforehand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from bayestissue.base import runtime
from bayestissue.base.settings import TomlTable, checked, only, parse_toml, read_text
from bayestissue.recordings.dataset.dataset_file import Gravity, LowPassFilter, Positive, WordSettings
from bayestissue.studies.planning.design_prior import BLOCK, PlannedPopulation
from bayestissue.studies.simulation.simulation_file import Condition, Count, Factor, RecordedDeceleration

Minutes = Annotated[float, Field(ge=0, allow_inf_nan=False)]
# A recorder of a usual kind, where a plan says nothing of it.
USUAL = RecordedDeceleration(
    noise_relative_to_peak=0.005,
    offset_sd_m_s2=0.2,
    relative_gain_sd=0.005,
    velocity_sd_m_s=0.01,
    relative_mass_sd=0.002,
)
# More designs than a reader compares; a slip of the grid rather than a wish.
MOST_DESIGNS = 500
# More need more memory than a machine has: studies are drawn and analysed a hundred at a time.
MOST_PEOPLE, MOST_IMPACTS = 1000, 50_000


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _sets(value: Any) -> Any:
    """A list of sets of numbers; one set, or one number, is a list of one."""
    values = _listed(value)
    return values if any(isinstance(inner, list | tuple) for inner in values) else [values]


Counts = Annotated[tuple[Count, ...], Field(min_length=1), BeforeValidator(_listed)]
Set = Annotated[tuple[Positive, ...], Field(min_length=1)]
Sets = Annotated[tuple[Set, ...], BeforeValidator(_sets)]
Share = Annotated[float, Field(ge=0, lt=1)]


class PlannedFactor(Factor):
    """The same, or a group that each person belongs to, such as a sex.

    Attributes:
        of_people: whether each person belongs to one level, as to a sex; the levels then have as many people
            each. Else every person is hit at every level.
    """

    of_people: bool = False

    @property
    def within(self) -> bool:
        """Whether a person has several of its levels."""
        return not self.of_people


def _has_noise(recording: RecordedDeceleration) -> bool:
    return bool(recording.noise_sd_m_s2 or recording.noise_relative_to_peak)


_NOISE = "noise_sd_m_s2 or noise_relative_to_peak above 0, as every recorder has noise"


class PlannedRecorder(RecordedDeceleration):
    """A recorder to compare, with the keys of [recording]; what it leaves out is 0.

    Attributes:
        name: what tables call it.
    """

    name: Annotated[str, Field(min_length=1)]

    def contradictions(self) -> Iterator[str]:
        """A recorder has noise."""
        yield from super().contradictions()
        if not _has_noise(self):
            yield _NOISE


class Candidates(TomlTable):
    """The designs to compare: every combination of what is listed, every person in every condition.

    Attributes:
        people: how many are recruited; of a list each is a candidate.
        masses_kg: the masses that every person is hit by: a list of numbers is one set, a list of lists
            several candidates. Left out where conditions are listed.
        velocities_m_s: the velocities at contact of every mass, in the same way.
        conditions: a list of [[candidates.conditions]]: one more set of conditions, beside those of masses
            and velocities, for pairs that are no full grid.
        repeats: impacts of each person in each condition (and at each level of a factor); of a list each is a
            candidate.
        factors: a list of [[candidates.factors]]: further columns, such as side or session.
        recorders: a list of [[candidates.recorders]], each a candidate, in the place of [recording]. Of
            designs that take the same minutes that of the first recorder is chosen: the cheapest stands
            first.
        lost: share of impacts that will give no recording.
        lost_people: share of the recruited who are never measured.
    """

    people: Counts
    masses_kg: Sets = ()
    velocities_m_s: Sets = ((1.5,),)
    conditions: tuple[Condition, ...] = ()
    repeats: Counts = (1,)
    factors: tuple[PlannedFactor, ...] = ()
    recorders: tuple[PlannedRecorder, ...] = ()
    lost: Share = 0.0
    lost_people: Share = 0.0

    def contradictions(self) -> Iterator[str]:
        """Designs are of some masses, told apart by names, and not too many or too large."""
        if not (self.masses_kg or self.conditions):
            yield "masses_kg, or a list of [[candidates.conditions]]"
        for what, named in (("factor", self.factors), ("recorder", self.recorders)):
            if len({one.name for one in named}) < len(named):
                yield f"a different name of each {what}"
        sets = len(self.masses_kg) * len(self.velocities_m_s) + bool(self.conditions)
        count = sets * len(self.people) * len(self.repeats) * max(len(self.recorders), 1)
        if count > MOST_DESIGNS:
            yield f"at most {MOST_DESIGNS} designs, and not the {count} of these lists"
        conditions = [len(m) * len(v) for m in self.masses_kg for v in self.velocities_m_s]
        levels = [len(factor.levels) for factor in self.factors if factor.every and factor.within]
        of_person = max([*conditions, len(self.conditions)]) * math.prod(levels) * max(self.repeats)
        if (people := max(self.people)) > MOST_PEOPLE:
            yield f"at most {MOST_PEOPLE} people in a design, and not {people}"
        if (impacts := people * of_person) > MOST_IMPACTS:
            yield (
                f"at most {MOST_IMPACTS} impacts in a design, and not {people} people with {of_person} each, "
                f"which are {impacts}"
            )


class After(TomlTable):
    """A study that has begun; the candidates are then what is still to come.

    Attributes:
        run: the folder of its fit, whose model is that of the plan.
        dataset: the folder of the recordings that were fitted.
        again: whether the people are first those that were recorded, hit again; else they are new.
    """

    run: str
    dataset: str
    again: bool = False


class Precision(TomlTable):
    """A number that is to be known well enough: half the width of its 90 % interval.

    Attributes:
        of: what, as a question asks it: "K[subject=new]", "mass_exponent_K", "peak_force[mass_kg=5,
            velocity_m_s=2]".
        half_width: the half width to reach, in the unit of the number.
        relative: the half width to reach as a fraction: the square root of high over low, less 1. One of the
            two is given.
    """

    of: Annotated[str, Field(min_length=1)]
    half_width: Positive | None = None
    relative: Positive | None = None

    def contradictions(self) -> Iterator[str]:
        """One of the two is given."""
        if (self.half_width is None) == (self.relative is None):
            yield "one of half_width and relative"


class Cost(TomlTable):
    """Minutes of work, by which the cheapest design is chosen.

    Attributes:
        person_min: of a person, however often the person is hit.
        impact_min: of an impact.
        mass_change_min: of a change of the mass: a person has one fewer than there are masses.
    """

    person_min: Minutes = 20.0
    impact_min: Minutes = 1.0
    mass_change_min: Minutes = 2.0


class Aim(TomlTable):
    """When a study counts as having answered, and how sure it is to be of that.

    Attributes:
        assurance: the probability that is wanted of a study that answers.
        probability: a claim is answered once its posterior probability is above this, or below 1 less this.
        studies: studies that are drawn of each design.
        seed: same seed, same machine: same numbers.
    """

    assurance: Annotated[float, Field(gt=0, lt=1)] = 0.8
    probability: Annotated[float, Field(gt=0.5, lt=1)] = 0.95
    studies: Annotated[int, Field(ge=BLOCK, le=1_000_000, multiple_of=BLOCK)] = 500
    seed: Annotated[int, Field(ge=0, le=runtime.MOST_SEED)] = 0


class PlanSpecification(TomlTable):
    """A whole plan file.

    Attributes:
        name: what the page calls the plan.
        description: free text.
        model: the analysis: the name of a model that comes with the program, or a model file.
        formula: formulas in place of the model's, by K and C. Where neither has one it is log(mass_kg) +
            (1|subject) + (1|trial), with factor + (1|subject:factor) of each factor that a question names,
            less what a design can't determine.
        reference_mass_kg: the mass that K and C of [population] and of questions are at. Left out: the
            model's, or 0.7.
        candidates: the designs to compare.
        recording: the measuring chain. Left out, a usual one: noise of 0.5 % of the peak, gain to 0.5 %, zero
            to 0.2 m/s², velocity to 0.01 m/s, mass to 0.2 %, at 10 kHz. Where the table is written, what it
            leaves out is 0.
        recorder: a table [recorder] as in dataset.toml: a low-pass.
        gravity: the part of gravity along the motion, as signal.gravity of dataset.toml.
        population: what is believed of people and tissue before the study.
        pilot: the folder of a finished fit, whose posterior is what is believed; [population] then says what
            the fit has no parameter for.
        after: a study that has begun; model, formula, pilot and population are then its own.
        words: what the answer and the page call people, conditions and impacts, as in dataset.toml. Left out,
            they are the words of the dataset of [after], or of that of the pilot.
        questions: claims to be decided, by a name each, as `bayestissue ask` asks them.
        precision: numbers to be known well enough, by a name each.
        cost: minutes of work.
        goal: what counts as answered, and how sure the study is to be of it.
    """

    name: Annotated[str, Field(min_length=1)]
    description: str = ""
    model: str = "impact"
    formula: dict[str, str] = Field(default_factory=dict)
    reference_mass_kg: Positive | None = None
    candidates: Candidates
    recording: Annotated[RecordedDeceleration, only(_has_noise, _NOISE)] = USUAL
    recorder: LowPassFilter | None = None
    gravity: Gravity = "none"
    population: PlannedPopulation = PlannedPopulation()
    pilot: str | None = None
    after: After | None = None
    words: WordSettings | None = None
    questions: dict[str, str] = Field(default_factory=dict)
    precision: dict[str, Precision] = Field(default_factory=dict)
    cost: Cost = Cost()
    goal: Aim = Aim()

    def contradictions(self) -> Iterator[str]:
        """Something is asked, of recorders that can record it."""
        if not (self.questions or self.precision):
            yield "a claim in [questions], or a number in [precision]"
        if twice := sorted(set(self.questions) & set(self.precision)):
            yield f"a name for each goal; in [questions] and [precision]: {', '.join(twice)}"
        if self.candidates.recorders and "recording" in self.model_fields_set:
            yield "either [recording] or [[candidates.recorders]]"
        for recording in self.recordings.values():
            yield from recording.unfit_for(self.recorder)

    @property
    def recordings(self) -> dict[str, RecordedDeceleration]:
        """The measuring chain of each recorder, by its name; "" where there is one alone."""
        return {recorder.name: recorder for recorder in self.candidates.recorders} or {"": self.recording}


def read_plan(path: Path) -> PlanSpecification:
    """Read and check a plan file; one without ``name`` has the file's.

    Raises:
        InputError: the file can't be read, or holds keys or values that are not allowed; all are named.
    """
    text = read_text(path, str(path))
    return plan_of({"name": path.stem} | parse_toml(text, str(path)), str(path), text=text)


def plan_of(content: Mapping[str, Any], file: str, *, text: str = "") -> PlanSpecification:
    """A plan from the content of its file, which messages call ``file``, with the rows of its ``text``.

    Raises:
        InputError: as of `read_plan`.
    """
    return checked({"name": "plan"} | dict(content), PlanSpecification, file=file, text=text)
