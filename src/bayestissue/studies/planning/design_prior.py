"""What is believed of the tissue before the study: where each planned study's truth is drawn from.

This design prior is not the analysis prior. The analysis is meant to convince whoever reads it, with the wide
priors of its model file; the design prior holds all that is known while planning (O'Hagan and Stevens 2001,
doi:10.1177/0272989X0102100307). A number in the place of a distribution is taken as known, and with numbers
alone assurance is power.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal
from zlib import crc32

import numpy as np
import xarray as xr
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
from bayestissue.studies.planning.study_posterior import PlannedModel

BLOCK = SETTINGS.block
# Of a standard deviation that [population] says nothing of.
_UNSTATED = half_normal(0.1)


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


# Quantiles of each kind of belief.
_QUANTILES: dict[type[TomlTable], Callable[[Any, Any], Any]] = {
    Known: lambda known, p: np.full(np.shape(p), known.value),
    Normal: lambda normal, p: stats.norm.ppf(p, normal.mean, normal.sd),
    HalfNormal: lambda half, p: stats.halfnorm.ppf(p, scale=half.scale),
    HalfStudentT: lambda half, p: stats.t.ppf((1 + p) / 2, half.df, scale=half.scale),
    Correlation: lambda lkj, p: 2 * stats.beta.ppf(p, lkj.concentration, lkj.concentration) - 1,
}


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
class FittedDraws:
    """The posterior of a finished fit, of which the truth of each study is a draw.

    Attributes:
        population: of the reported parameters, [draw], by name.
        reference_mass_kg: the mass that the intercepts are at.
        effects: of a running study the effects of the levels that were recorded, [draw, level], by name, with
            the levels' names.
        mass_errors: of a running study the errors of log mass of the impacts that were recorded, [draw,
            impact]; None where these are so many that not all draws were kept.
    """

    population: Mapping[str, Float[np.ndarray, " draw"]]
    reference_mass_kg: float
    effects: Mapping[str, xr.DataArray] = field(default_factory=dict)
    mass_errors: Float[np.ndarray, "draw impact"] | None = None

    def rows(self, streams: Streams) -> Int[np.ndarray, " study"]:
        """Which draw each study of a block has."""
        return (streams.uniform("pilot") * len(next(iter(self.population.values())))).astype(int)

    def effects_of(
        self, design: Design, row: Int[np.ndarray, " study"]
    ) -> dict[str, Float[np.ndarray, "study level"]]:
        """What `Truths` has of the group effects."""
        effects = {}
        for q, part in design.responses.items():
            for term, column in part.terms.items():
                if (name := term.variable(q)) not in self.effects:
                    continue
                # Of levels that were not recorded nothing is known.
                levels = list(design.groupings[term.grouping].levels)
                values = self.effects[name].reindex({term.grouping: levels}).to_numpy()[row]
                shared = common_coefficient(term.slope, q) if term.slope else ""
                if shared in self.population:
                    values = values - np.asarray(self.population[shared])[row][:, None]
                effects[term.effect(q)] = values * column.scale
        return effects


@dataclass(frozen=True, eq=False)
class DesignPrior:
    """Where the truth of each planned study comes from.

    Attributes:
        beliefs: of what no fit has a parameter for, such as a side that it did not have.
        fitted: of all else a draw of a finished fit's posterior a study, all of its parameters together.
        at_median: whether beliefs, or the fit's parameters, are at their medians: one assumed truth.
        without: name of a standard deviation that is 0, less its response, such as ``sd_trial``: the levels
            of that group do not differ, as if chance spared the study.
    """

    beliefs: PlannedPopulation
    fitted: FittedDraws | None = None
    at_median: bool = False
    without: str = ""

    def truths(self, model: PlannedModel, design: Design, streams: Streams) -> Truths:
        """The truth of each study of a block."""
        known, values = self.beliefs.by_name(), self._fitted_values(design, streams)

        def value(name: str, belief: Any, unit: float = 1.0) -> np.ndarray:
            if name in values:
                return values[name]
            # Where nothing is said of a term, one truth has no median of it.
            median = self.at_median and belief is not _UNSTATED
            probability = np.full(BLOCK, 0.5) if median else streams.uniform(name)
            return np.asarray(_QUANTILES[type(belief)](belief, probability), float) / unit

        spreads = {name: value(name, known.get(name, _UNSTATED)) for name in model.hyperparameters}
        none = {f"{self.without}_{q}": np.zeros(BLOCK) for q in design.responses}
        fixed: dict[str, np.ndarray] = {}
        for q, part in design.responses.items():
            names = [intercept(part.parameter), *[f"mass_exponent_{q}"] * (part.log_mass is not None)]
            fixed |= {name: value(name, known[name])[:, None] for name in names}
            effects = []
            for column, scale in zip(part.names, part.scale, strict=True):
                name, single = common_coefficient(column, q), self.beliefs.effects.get(q, {}).get(column)
                of_unit = value(name, single) if single else value(name, known[f"covariate_{q}"], scale)
                effects.append(of_unit * scale)
            if effects:
                fixed[f"covariate_effect_{q}"] = np.stack(effects, axis=1)
        truths = Truths({name: none.get(name, spread) for name, spread in spreads.items()}, fixed)
        if self.fitted is None:
            return truths
        row, errors = self.fitted.rows(streams), self.fitted.mass_errors
        return replace(
            truths,
            effects=self.fitted.effects_of(design, row),
            mass_errors=None if errors is None else errors[row],
        )

    def _fitted_values(self, design: Design, streams: Streams) -> dict[str, Float[np.ndarray, " study"]]:
        """The fit's parameters in each study, coefficients in their covariates' own units, by name."""
        if self.fitted is None:
            return {}
        drawn = {name: np.asarray(values) for name, values in self.fitted.population.items()}
        if self.at_median:
            drawn = {name: np.full(BLOCK, np.median(values)) for name, values in drawn.items()}
        else:
            row = self.fitted.rows(streams)
            drawn = {name: values[row] for name, values in drawn.items()}
        moved = math.log(design.reference_mass_kg / self.fitted.reference_mass_kg)
        for q, part in design.responses.items():
            if (name := intercept(part.parameter)) in drawn:
                drawn[name] = drawn[name] + moved * drawn.get(f"mass_exponent_{q}", 0.0)
        return drawn
