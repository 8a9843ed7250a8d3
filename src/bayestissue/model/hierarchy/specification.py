"""The model file: what is modelled, with which priors, sampled how. Checked whole before anything runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import (
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from bayestissue.base.declarations import declared, sentences
from bayestissue.base.errors import Problem
from bayestissue.base.resources import model_content
from bayestissue.base.settings import TomlTable, checked, read_text
from bayestissue.mechanics.elements.library import element, element_names
from bayestissue.model.hierarchy import SIDE_BY_SIDE
from bayestissue.model.hierarchy.formulas.formula import terms_of
from bayestissue.model.hierarchy.formulas.group_terms import SUBJECT, TRIAL, GroupTerm
from bayestissue.model.hierarchy.priors import SD_OF_TERM, ElementPrior, Normal, Priors
from bayestissue.recordings.signal import SignalOptions

Likelihood = Literal["published-estimates", "arma", "a2", "impact"]
Discrepancy = Literal["automatic", "none", "always"]
MassError = Literal["impact", "mass", "subject", "all"]
GainError = Literal["all", "impact"]
REACH_PEAK = ("peak", "rebound")
_SAID = sentences(__package__)
# What is stated, by name: keys of a model file, what a dataset has, and what a command does.
type Facts = Mapping[str, Any]


class Combination(NamedTuple):
    """Facts that do not go together.

    Attributes:
        facts: by name the values that take part in it.
        at: the key that is named; empty where the whole is.
        message: of ``remedies.toml``.
        words: or a clause.
    """

    facts: Mapping[str, Sequence[Any]]
    at: str = ""
    message: str = ""
    words: str = ""


COMBINATIONS = tuple(Combination(**one) for one in declared(__package__, "combinations.toml")["combination"])


def refused(facts: Facts, at: str) -> list[Combination]:
    """The combinations of ``facts`` that are refused at a key."""
    return [
        one
        for one in COMBINATIONS
        if one.at == at and all(facts.get(name) in allowed for name, allowed in one.facts.items())
    ]


def unsuited(facts: Facts, at: str, source: str) -> list[Problem]:
    """A problem for each combination of ``facts`` that is refused at a key of ``source``."""
    return [Problem.stated(one.message, source, None, at, facts[at], **facts) for one in refused(facts, at)]


class Formulas(TomlTable):
    """Right-hand sides for log K, log C and the log of an element's further parameters, by their names.

    In the notation of R and formulae. Of K and C one left out is
    `bayestissue.model.hierarchy.formulas.formula.DEFAULT_FORMULA` less what the data can't tell; any other is
    "1". Iterates over pairs of name and formula.

    Attributes:
        K: of log K. Left out: log(mass_kg) + (1|subject) + (1|trial), without the terms that the data can't
            determine.
        C: of log C, as of log K.
    """

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, str] = Field(init=False)

    K: str | None = None
    C: str | None = None

    @property
    def further(self) -> tuple[str, ...]:
        """The parameters besides K and C that have a formula."""
        return tuple(self.__pydantic_extra__)

    def group_terms(self) -> tuple[GroupTerm, ...]:
        """The group terms that are asked for besides (1|subject) and (1|trial), each once."""
        terms = dict.fromkeys(term for _, formula in self for term in terms_of(formula).groups)
        return tuple(term for term in terms if term not in (SUBJECT, TRIAL))


class PracticalEquivalence(TomlTable):
    """How near a mass exponent, or a ratio, must be to a hypothesis to count as equal to it in practice.

    Attributes:
        mass_exponent: a mass exponent so near to 0, or to 1, counts as equal to it.
        ratio: of a comparison, as of left over right: from 1 / (1 + ratio) to 1 + ratio counts as 1.
    """

    mass_exponent: Annotated[float, Field(gt=0, lt=0.5)] = 0.1
    ratio: Annotated[float, Field(gt=0, lt=1)] = 0.1


class Sampler(TomlTable):
    """Of the Markov chains that draw from the posterior.

    Attributes:
        chains: independent chains, which convergence is judged by.
        draws: draws of a chain that are kept, at most.
        effective: effective draws of every quantity, in its middle and its tails, with which the chains end.
        transitions: transitions of a chain after its warm-up, at most: where they do not suffice, the run
            says so.
    """

    chains: Annotated[int, Field(ge=2, le=64)] = 4
    draws: Annotated[int, Field(ge=100, le=100_000)] = 1000
    effective: Annotated[int, Field(ge=50, le=100_000)] = 400
    transitions: Annotated[int, Field(ge=100, le=10_000_000)] = 40_000


class CompetingFormulas(TomlTable):
    """Other explanations of the same data: a name and the formula that takes both responses' place.

    Attributes:
        formulas: a name and the formula of it each. Of published estimates alone.
    """

    formulas: dict[str, str] = Field(default_factory=dict)


class ModelSpecification(TomlTable):
    """A whole model file; ``bayestissue model NAME`` prints commented ones.

    Attributes:
        name: what pages and tables call the model; of a file that leaves it out, the file's own.
        description: free text, shown on the page.
        likelihood: what of a recording is modelled. impact: the deceleration of a mass on an element, seen
            through the measuring chain. arma: the displacement as an ARMA(2,1). a2: the displacement as a
            sampled second-order process. published-estimates: printed K and C, of `bayestissue reproduce`
            alone.
        signal: how a displacement is made from the recording, and which part of it is used.
        discrepancy: a smooth force of unknown shape beside the element's. automatic: where the residuals of a
            fit without it are plainly structured. Of the impact likelihood alone.
        reference_mass_kg: the mass that K and C of people are given at. Left out: the geometric mean of the
            impacts' masses.
        formula: what log K and log C depend on, in the notation of R; also the log of an element's further
            parameter, by its name.
        residual_correlation: whether the deviations of log K and log C of one impact are correlated.
        mass_error: impact: every impact's mass has an error of its own. mass: impactors were weighed once
            each, and impacts of the same mass in the table share one error. subject: the mass is a person's,
            such as an effective mass, and its error the same in all of the person's impacts. all: one
            impactor, or one balance, and the same error in all impacts.
        gain_error: all: one sensor, whose gain errs by one factor in all impacts. impact: every impact's gain
            has an error of its own.
        priors: what is believed before the data are seen, on the log scale.
        practical_equivalence: which differences count as none in practice.
        comparison: other explanations of the same data.
        questions: asked of the finished fit, by a name each, as `bayestissue ask` asks them. Of fits of
            traces alone.
        sampler: how draws of the posterior are made.
    """

    name: Annotated[str, Field(min_length=1)]
    description: str = ""
    likelihood: Likelihood
    element: str = Field(
        default=SIDE_BY_SIDE,
        description=f"what the impactor meets: {', '.join(element_names())}. Of the impact likelihood alone.",
    )
    signal: SignalOptions = SignalOptions()
    discrepancy: Discrepancy = "automatic"
    reference_mass_kg: Annotated[float, Field(gt=0)] | None = None
    formula: Formulas = Formulas()
    residual_correlation: bool = True
    mass_error: MassError = "impact"
    gain_error: GainError = "all"
    priors: Priors = Priors()
    practical_equivalence: PracticalEquivalence = PracticalEquivalence()
    comparison: CompetingFormulas = CompetingFormulas()
    questions: dict[str, str] = Field(default_factory=dict)
    sampler: Sampler = Sampler()

    @model_validator(mode="before")
    @classmethod
    def _none_of_displacements(cls, content: Any) -> Any:
        if isinstance(content, dict) and content.get("likelihood") != "impact":
            return {"discrepancy": "none", **content}
        return content

    @field_validator("discrepancy", "questions")
    @classmethod
    def _combined(cls, value: Any, info: ValidationInfo) -> Any:
        key = str(info.field_name)
        stated = cls.model_construct(**info.data, **{key: value})
        for one in refused(stated.facts, key):
            raise ValueError(one.words)
        return value

    @field_validator("element")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in element_names():
            raise ValueError(f"one of {', '.join(element_names())}")
        return name

    @field_validator("formula")
    @classmethod
    def _of_parameters(cls, formulas: Formulas, info: ValidationInfo) -> Formulas:
        if "element" not in info.data:
            return formulas
        extra = [parameter.name for parameter in element(info.data["element"]).extra]
        if strange := sorted(set(formulas.further) - set(extra)):
            raise _strange("formulas", ["K", "C", *extra], strange)
        return formulas

    @property
    def facts(self) -> dict[str, Any]:
        """What `COMBINATIONS` are of."""
        return dict(self) | {
            "reaches_peak": self.reaches_peak,
            "side_by_side": self.element == SIDE_BY_SIDE,
            "asks": bool(self.questions),
        }

    def group_terms(self) -> tuple[GroupTerm, ...]:
        """`Formulas.group_terms` of the model's own formulas and of those that compete with them."""
        models = [self.formula, *(Formulas(K=text, C=text) for text in self.comparison.formulas.values())]
        return tuple(dict.fromkeys(term for formulas in models for term in formulas.group_terms()))

    @model_validator(mode="after")
    def _together(self) -> Self:
        extra = [parameter.name for parameter in element(self.element).extra]
        if strange := sorted(set(self.priors.element) - set(extra)):
            raise _strange("element_priors", extra, strange, element=self.element)
        for one in refused(self.facts, ""):
            raise ValueError(one.words)
        terms = self.group_terms()
        if strange := [str(term) for term in self.priors.of_terms() if term not in terms]:
            raise _strange("term_priors", map(str, terms), strange)
        responses = ("K", "C", *self.formula.further)
        further = self.priors.further()
        if unknown := sorted(name for name in further if name.rpartition(".")[-1] not in responses):
            raise _strange("response_priors", responses, unknown)
        return self

    def alone(self) -> Self:
        """Of one impact by itself, whose errors of mass and gain are its own, whoever shares them."""
        by_itself = {"formula": Formulas(K="1", C="1"), "discrepancy": "none", "mass_error": "impact"}
        return self.model_copy(update=by_itself | {"gain_error": "impact"})

    @property
    def may_add_discrepancy(self) -> bool:
        """Whether the program may add a discrepancy: only to a window that reaches the peak."""
        return self.discrepancy == "automatic" and self.reaches_peak

    @property
    def reaches_peak(self) -> bool:
        """Whether the window holds the greatest penetration."""
        return self.signal.window in REACH_PEAK

    def priors_passed_over(self, in_data: Iterable[GroupTerm]) -> list[str]:
        """The group terms of priors that are other ones in the data: ``(1|patient)``, the subject's."""
        known = {str(term).casefold() for term in in_data}
        return [
            str(term)
            for term, pair in self.priors.of_terms().items()
            if pair != SD_OF_TERM and term in self.formula.group_terms() and str(term).casefold() not in known
        ]

    def complete_priors(self, in_data: Iterable[GroupTerm] = ()) -> Priors:
        """The priors, those of the element's parameters and of group terms too that the file leaves out.

        Args:
            in_data: the group terms with the columns of a table, which formulas may write in another case.
        """
        element_priors = {
            x.name: ElementPrior(log=Normal(distribution="normal", mean=math.log(x.typical), sd=x.log_sd))
            for x in element(self.element).extra
        }
        set_apart = self.priors.of_terms()
        folded = {str(term).casefold(): pair for term, pair in set_apart.items()}
        all_terms = dict.fromkeys([*self.group_terms(), *(t for t in in_data if t not in (SUBJECT, TRIAL))])
        terms = {
            term: set_apart.get(term, folded.get(str(term).casefold(), SD_OF_TERM)) for term in all_terms
        }
        return self.priors.model_copy(
            update={
                "element": element_priors | self.priors.element,
                "sd_group": {x.grouping: pair for x, pair in terms.items() if not x.slope},
                "sd_slope": {f"{x.slope}|{x.grouping}": pair for x, pair in terms.items() if x.slope},
            }
        ).with_further(self.formula.further)


def _strange(key: str, known: Iterable[str], strange: Iterable[str], **words: str) -> ValueError:
    """What a key may hold, and what it holds besides."""
    allowed = ", ".join(known) or "nothing"
    return ValueError(_SAID(f"allowed.{key}", known=allowed, strange=", ".join(strange), **words))


def read_specification(path: Path) -> ModelSpecification:
    """Read and check a model file, with what the one that it is ``like`` says.

    Raises:
        InputError: the file is missing, is not TOML, or holds a key or value that is not allowed; every
            such key is named with what is allowed.
    """
    return specification_of(model_content(path), str(path), text=read_text(path, str(path)))


def specification_of(content: Mapping[str, Any], file: str, *, text: str = "") -> ModelSpecification:
    """A model from the content of its file, with all priors.

    Args:
        content: as TOML has it.
        file: what messages call it.
        text: of the file, whose rows messages then name.

    Raises:
        InputError: as of `read_specification`.
    """
    specification = checked({"name": "own"} | dict(content), ModelSpecification, file=file, text=text)
    return specification.model_copy(update={"priors": specification.complete_priors()})
