"""What is believed of the tissue before the study: where each planned study's truth is drawn from.

This design prior is not the analysis prior. The analysis is meant to convince whoever reads it, with the wide
priors of its model file; the design prior holds all that is known while planning (O'Hagan and Stevens 2001,
doi:10.1177/0272989X0102100307). A number in the place of a distribution is taken as known, and with numbers
alone assurance is power.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, Protocol, Self
from zlib import crc32

import numpy as np
from jaxtyping import Float, Int
from pydantic import BeforeValidator, Field
from scipy import stats

from bayestissue.base.settings import TomlTable
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import common_coefficient
from bayestissue.model.hierarchy.priors import (
    Correlation,
    HalfNormal,
    HalfStudentT,
    Normal,
    Pair,
    Responses,
    half_normal,
    normal,
    term_of_group,
    term_of_slope,
)
from bayestissue.model.hierarchy.responses import intercept
from bayestissue.studies.planning.plan_settings import PLAN as SETTINGS
from bayestissue.studies.planning.study_model import PlannedModel

BLOCK = SETTINGS.block


class Known(TomlTable):
    """A number that is taken as known."""

    distribution: Literal["known"] = "known"
    value: Annotated[float, Field(allow_inf_nan=False)]


def _number(value: Any) -> Any:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return {"distribution": "known", "value": value} if is_number else value


Belief = Annotated[
    Known | Normal | HalfNormal | HalfStudentT | Correlation,
    Field(discriminator="distribution"),
    BeforeValidator(_number),
]


def _alike(belief: Any) -> Any:
    return Responses[Belief](K=belief, C=belief)


class PlannedPopulation(TomlTable):
    """The table ``[population]``: the keys of a model file's ``[priors]``, each a distribution or a number.

    All are on the log scale of K (N/m) and C (N s/m), at the reference mass of the analysis.

    Attributes:
        intercept: log K and log C of a typical person.
        mass_exponent: slopes of log K and log C on log mass.
        covariate: change of log K and log C for one standard deviation of any other covariate, but for those
            in effects.
        effects: the same of single covariates, in the covariate's own unit, by response and name:
            [population.effects.K] with "side[right]" = 0.1.
        sd_subject: standard deviation between people.
        sd_trial: standard deviation between conditions beyond what the covariates explain.
        sd_group: of another group term, by its name, such as "subject:side".
        sd_slope: of a slope between levels, such as "log(mass_kg)|subject".
        sd_impact: standard deviation between the impacts of one person in one condition.
        residual_correlation: correlation of the deviations of one impact.
    """

    intercept: Pair[Belief] = Pair[Belief](K=normal(math.log(3000), 0.4), C=normal(math.log(25), 0.4))
    mass_exponent: Responses[Belief] = _alike(normal(0.5, 0.5))
    covariate: Responses[Belief] = _alike(normal(0.0, 0.15))
    effects: dict[str, dict[str, Belief]] = Field(default_factory=dict)
    sd_subject: Responses[Belief] = _alike(half_normal(0.3))
    sd_trial: Responses[Belief] = _alike(half_normal(0.05))
    sd_group: dict[str, Responses[Belief]] = Field(default_factory=dict)
    sd_slope: dict[str, Responses[Belief]] = Field(default_factory=dict)
    sd_impact: Responses[Belief] = _alike(half_normal(0.1))
    residual_correlation: Belief = Known(value=0.0)

    def by_name(self) -> dict[str, Any]:
        """Of every top-level parameter, by its name: ``intercept_K``, ``sd_subject_side_C``."""
        pairs = {name: pair for name, pair in self if isinstance(pair, Pair)}
        pairs |= {f"sd_{term_of_group(key).stem}": pair for key, pair in self.sd_group.items()}
        pairs |= {f"sd_{term_of_slope(key).stem}": pair for key, pair in self.sd_slope.items()}
        beliefs = {f"{stem}_{q}": belief for stem, pair in pairs.items() for q, belief in pair}
        return beliefs | {"residual_correlation": self.residual_correlation}

    def at_median(self) -> Self:
        """Every belief replaced by its median: one assumed truth."""

        def known(value: Any) -> Any:
            match value:
                case dict():
                    return {key: known(part) for key, part in value.items()}
                case Pair():
                    return value.model_copy(
                        update={name: Known(value=float(quantile(part, 0.5))) for name, part in value}
                    )
                case _:
                    return Known(value=float(quantile(value, 0.5)))

        return self.model_copy(update={name: known(getattr(self, name)) for name in type(self).model_fields})

    def truths(self, model: PlannedModel, design: Design, streams: Streams) -> Truths:
        """Draw every parameter that the model has."""
        return Truths.of_named(model, design, self.named(model, design, streams))

    def named(
        self, model: PlannedModel, design: Design, streams: Streams
    ) -> dict[str, Float[np.ndarray, " study"]]:
        """Hyperparameters, and coefficients in their covariates' own units, by name."""
        known = self.by_name()
        default = half_normal(0.1)

        def drawn(name: str, belief: Any) -> np.ndarray:
            return np.asarray(quantile(belief, streams.uniform(name)), float)

        # A factor that all masses have in common stands in the place of errors of their own.
        known |= {f"sd_{name}": Known(value=0.0) for name in model.nuisance}
        values = {name: drawn(name, known.get(name, default)) for name in model.hyperparameters}
        for part in design.responses.values():
            q = part.response
            names = [intercept(part.parameter), *[f"mass_exponent_{q}"] * (part.log_mass is not None)]
            values |= {name: drawn(name, known[name]) for name in names}
            for column, scale in zip(part.names, part.scale, strict=True):
                name, single = common_coefficient(column, q), self.effects.get(q, {}).get(column)
                values[name] = drawn(name, single) if single else drawn(name, known[f"covariate_{q}"]) / scale
        return values


def quantile(belief: Any, probability: Any) -> Any:
    """The quantiles of a belief."""
    match belief:
        case Known(value=value):
            return np.full(np.shape(probability), value)
        case Normal(mean=mean, sd=sd):
            return stats.norm.ppf(probability, mean, sd)
        case HalfNormal(scale=scale):
            return stats.halfnorm.ppf(probability, scale=scale)
        case HalfStudentT(df=df, scale=scale):
            return stats.t.ppf((1 + probability) / 2, df, scale=scale)
        case Correlation(concentration=concentration):
            return 2 * stats.beta.ppf(probability, concentration, concentration) - 1
    raise TypeError(type(belief))


@dataclass(frozen=True, eq=False)
class Truths:
    """The truth of each of some studies.

    Attributes:
        hyperparameters: by name.
        fixed: the fixed effects by the names of the parts of b, in the units of the design's columns.
        effects: the group effects that are known of some levels, NaN of others, by the same names.
        mass_errors: errors of log mass of the impacts that a running study has; None of a new one.
    """

    hyperparameters: dict[str, Float[np.ndarray, " study"]]
    fixed: dict[str, Float[np.ndarray, "study width"]]
    effects: Mapping[str, Float[np.ndarray, "study level"]] = field(default_factory=dict)
    mass_errors: Float[np.ndarray, "study recorded"] | None = None

    @classmethod
    def of_named(
        cls, model: PlannedModel, design: Design, values: Mapping[str, Float[np.ndarray, " study"]]
    ) -> Truths:
        """Of hyperparameters and coefficients by name, the latter in their covariates' own units."""
        fixed: dict[str, np.ndarray] = {}
        for part in design.responses.values():
            q = part.response
            names = [intercept(part.parameter), *[f"mass_exponent_{q}"] * (part.log_mass is not None)]
            fixed |= {name: values[name][:, None] for name in names}
            scaled = zip(part.names, part.scale, strict=True)
            if effects := [values[common_coefficient(name, q)] * scale for name, scale in scaled]:
                fixed[f"covariate_effect_{q}"] = np.stack(effects, axis=1)
        return cls({name: values[name] for name in model.hyperparameters}, fixed)


class DesignPrior(Protocol):
    """Where truths come from: a `PlannedPopulation`, or a pilot study's posterior."""

    def truths(self, model: PlannedModel, design: Design, streams: Streams) -> Truths:
        """The truth of each study of a block."""


class Streams:
    """Random numbers of one block of studies: of each name its own, the same whatever the design is."""

    def __init__(self, seed: int, block: int) -> None:
        self._seed = seed, block

    def _generator(self, name: str) -> np.random.Generator:
        return np.random.default_rng([*self._seed, crc32(name.encode())])

    def uniform(self, name: str) -> Float[np.ndarray, " study"]:
        """A number of each study."""
        return self._generator(name).uniform(size=BLOCK)

    def normal(self, name: str, number: int) -> Float[np.ndarray, "study number"]:
        """Some of each study; of a greater ``number`` the first are the same."""
        return self._generator(name).standard_normal((number, BLOCK)).T


@dataclass(frozen=True, eq=False)
class WithoutSpread:
    """Truths of another prior in which the levels of a group do not differ, as if chance spared the study.

    Attributes:
        prior: the other.
        spread: name of the standard deviation that is 0, less its response: ``sd_trial``.
    """

    prior: DesignPrior
    spread: str

    def truths(self, model: PlannedModel, design: Design, streams: Streams) -> Truths:
        """Those of the other prior, but for that."""
        truths = self.prior.truths(model, design, streams)
        none = {f"{self.spread}_{q}": np.zeros(BLOCK) for q in design.responses}
        values = {name: none.get(name, drawn) for name, drawn in truths.hyperparameters.items()}
        return replace(truths, hyperparameters=values)


@dataclass(frozen=True, eq=False)
class Pilot:
    """Truths from the posterior of a finished fit: every study's is one draw of it.

    What the pilot has no parameter for, such as a side that it did not have, is from ``otherwise``.

    Attributes:
        draws: of the pilot's reported parameters, [draw], by name.
        reference_mass_kg: the mass that its intercepts are at.
        otherwise: beliefs about the rest.
    """

    draws: Mapping[str, Float[np.ndarray, " draw"]]
    reference_mass_kg: float
    otherwise: PlannedPopulation

    def rows(self, streams: Streams) -> Int[np.ndarray, " study"]:
        """Which draw each study of a block has."""
        return (streams.uniform("pilot") * len(next(iter(self.draws.values())))).astype(int)

    def truths(self, model: PlannedModel, design: Design, streams: Streams) -> Truths:
        """One draw of the pilot's posterior a study, all of its parameters together."""
        row = self.rows(streams)
        drawn = {name: np.asarray(values)[row] for name, values in self.draws.items()}
        moved = math.log(design.reference_mass_kg / self.reference_mass_kg)
        for part in design.responses.values():
            if (name := intercept(part.parameter)) in drawn:
                drawn[name] = drawn[name] + moved * drawn.get(f"mass_exponent_{part.response}", 0.0)
        return Truths.of_named(model, design, self.otherwise.named(model, design, streams) | drawn)
