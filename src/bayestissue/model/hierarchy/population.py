"""The hierarchy over impacts as matrices: what b, all location parameters together, says of each impact.

An impact's own parameters are u = (log K, log C, log noise[, artanh theta1]), K and C at the recorded mass.
Given b and the standard deviations, u is normal about X b; b is normal too. Subject and trial effects,
intercepts, mass exponents and covariates are all parts of b, so everything linear is one vector.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.base.impact_arrays import IndexPerImpact, PerImpact, bucket
from bayestissue.model.hierarchy.design import Design, ResponseDesign
from bayestissue.model.hierarchy.gaussian.arrangement import PopulationDesign, arrange, expected
from bayestissue.model.hierarchy.gaussian.effects import Covariances
from bayestissue.model.hierarchy.priors import Priors
from bayestissue.model.hierarchy.responses import RESPONSES, intercept
from bayestissue.model.hierarchy.specification import MassError

# The part of b that has the errors of log mass which several impacts share.
MASS_ERROR = "log_mass_error"
# Standard deviations of effects and impacts and the residual correlation by name: of one draw, or of many.
type Hyperparameters = dict[str, Float[Any, "*draw"]]


class Population(NamedTuple):
    """Hyperparameters and effects: of one draw, or of many along first axes.

    Attributes:
        hyperparameters: by name.
        b: fixed and group effects, K and C at the recorded mass.
    """

    hyperparameters: Hyperparameters
    b: Float[Any, "*draw location"]


class EffectPart(NamedTuple):
    """Elements of b with one name and one prior.

    Attributes:
        name: such as ``intercept_K`` or ``subject_effect_C``.
        width: how many, of a group term's effects the `bucket` of its levels.
        mean: the prior's.
        sd: the prior's; None where it is itself unknown, or the dataset states it: of `MASS_ERROR`.
        spread: name of that unknown standard deviation, or "".
    """

    name: str
    width: int
    mean: float
    sd: float | None
    spread: str


@dataclass(frozen=True)
class EffectParts:
    """The parts of b in their order; equal by value, whatever dataset they were made for."""

    blocks: tuple[EffectPart, ...]

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Where each part is. Group effects beyond the levels that there are keep their prior."""
        ends = np.cumsum([part.width for part in self.blocks]).tolist()
        return {part.name: slice(end - part.width, end) for part, end in zip(self.blocks, ends, strict=True)}

    @cached_property
    def mean(self) -> Float[np.ndarray, " location"]:
        """Of the prior."""
        return self._of_all([part.mean for part in self.blocks])

    @cached_property
    def sd(self) -> Float[np.ndarray, " location"]:
        """Of the prior, NaN where it is None."""
        return self._of_all([np.nan if part.sd is None else part.sd for part in self.blocks])

    @cached_property
    def spread(self) -> tuple[str, ...]:
        """Name of each element's unknown standard deviation, or ""."""
        return tuple(part.spread for part in self.blocks for _ in range(part.width))

    @property
    def groups(self) -> list[slice]:
        """Where the effects of each group term are, and shared errors of mass."""
        return [self.parts[part.name] for part in self.blocks if part.spread or part.name == MASS_ERROR]

    @property
    def of_shared_masses(self) -> bool:
        """Whether impacts share errors of their masses."""
        return MASS_ERROR in self.parts

    @property
    def size(self) -> int:
        """Number of elements of b."""
        return len(self.mean)

    def _of_all(self, values: list[float]) -> np.ndarray:
        return np.repeat(np.array(values, float), [part.width for part in self.blocks])


class SharedMasses(NamedTuple):
    """Impacts whose masses share an error.

    With M_true = M_declared exp(e) a recording tells the logs of K and C, and of what else is in proportion
    to the mass, less e. In the mean of an impact's parameters e so stands as the effect of a group, crossed
    with people and conditions, whose standard deviation the dataset states. The population is that of the
    true K and C, its mass exponents those on the declared mass.

    Attributes:
        code: which error each impact has.
        parameters: names of an impact's parameters in proportion to the mass.
    """

    code: IndexPerImpact
    parameters: tuple[str, ...] = RESPONSES


def stated_mass_errors(
    whose: MassError,
    relative_sd: float,
    subject: IndexPerImpact,
    mass_kg: PerImpact,
    parameters: tuple[str, ...] = RESPONSES,
) -> tuple[float, float | None, SharedMasses | None]:
    """Whose the errors of recorded masses are.

    Errors of "mass" are each impact's own where no two masses are the same, and one of all where there is but
    one.

    Args:
        whose: as a model file states it.
        relative_sd: standard deviation of an error of log mass.
        subject: of each impact.
        mass_kg: as declared.
        parameters: as of `SharedMasses`.

    Returns:
        The standard deviation of errors that are each impact's own or of several, that of one of all, None
        where there is none, and which impacts share errors, None where none does.
    """
    if whose == "mass":
        different = len(np.unique(mass_kg))
        whose = "impact" if different == len(mass_kg) else "all" if different == 1 else "mass"
    if whose == "all":
        return 0.0, relative_sd, None
    if whose == "impact" or not relative_sd:
        return relative_sd, None, None
    labels = subject if whose == "subject" else mass_kg
    code = np.unique(labels, return_inverse=True)[1].reshape(-1)
    return relative_sd, None, SharedMasses(code, parameters)


def population_design(
    design: Design, priors: Priors, nuisance: tuple[str, ...], masses: SharedMasses | None = None
) -> tuple[EffectParts, PopulationDesign]:
    """Arrange a design: b is (all of log K's, all of log C's, each nuisance parameter's, errors of masses).

    Of a nuisance parameter without a formula of its own that is the mean over impacts alone.

    Args:
        design: the formulas evaluated over the impacts.
        priors: of which those of the parts of b are read.
        nuisance: names of an impact's parameters besides log K and log C.
        masses: of impacts that share an error of the mass.

    Returns:
        What the elements of b are, and X with rows that repeat kept once, arranged for elimination.
    """
    first, row = _distinct_rows(design, masses)
    effects, columns = effects_of(design, priors, nuisance, first)
    if masses is None:
        return effects, arrange(columns, row, effects.groups)
    levels = bucket(int(masses.code.max()) + 1)
    effects = EffectParts((*effects.blocks, EffectPart(MASS_ERROR, levels, 0.0, None, "")))
    of_masses = np.where(masses.code[first, None] == np.arange(levels), 1.0, 0.0)
    moved = np.where(np.isin([*RESPONSES, *nuisance], masses.parameters), -1.0, 0.0)
    return effects, arrange([*columns, of_masses], row, effects.groups, moved)


def effects_of(
    design: Design,
    priors: Priors,
    nuisance: tuple[str, ...],
    rows: Int[np.ndarray, " row"] | slice = slice(None),
) -> tuple[EffectParts, list[Float[np.ndarray, "row part"]]]:
    """What the elements of b are, and of each parameter its columns of X in some rows of the design."""
    known = priors.by_name()
    none = np.zeros((len(design.subject), 0))
    responses = {
        name: ResponseDesign(name, (), none, np.zeros(0), None, {}) for name in (*RESPONSES, *nuisance)
    }
    responses |= {part.parameter: part for part in design.responses.values()}
    columns, parts = zip(*(_columns(design, part, known, rows) for part in responses.values()), strict=True)
    return EffectParts(tuple(itertools.chain(*parts))), list(columns)


def _distinct_rows(
    design: Design, masses: SharedMasses | None
) -> tuple[Int[np.ndarray, " row"], IndexPerImpact]:
    """Rows of the design of which no two are alike, and of each impact the number of that which is its own.

    Rows of X are alike where all that its terms are made of is: one column of levels, where X has a hundred.
    """
    groupings_used = {term.grouping for part in design.responses.values() for term in part.terms}
    keys = [*(design.groupings[name].code for name in sorted(groupings_used))]
    for part in design.responses.values():
        keys += [column for columns in reversed(part.fixed.values()) for column in columns.T]
        keys += [column.covariate for column in part.terms.values()]
    keys += [] if masses is None else [masses.code]
    _, first, row = np.unique(np.stack(keys, axis=1), axis=0, return_index=True, return_inverse=True)
    return first, row.reshape(-1)


def _columns(
    design: Design, part: ResponseDesign, priors: Mapping[str, Any], rows: Int[np.ndarray, " row"] | slice
) -> tuple[np.ndarray, list[EffectPart]]:
    matrices, pieces = [columns[rows] for columns in part.fixed.values()], []
    for name, columns in part.fixed.items():
        prior = priors[name.replace("covariate_effect", "covariate")]
        pieces.append(EffectPart(name, columns.shape[1], prior.mean, prior.sd, ""))
    for term, column in part.terms.items():
        grouping = design.groupings[term.grouping]
        levels = bucket(len(grouping.levels))
        of_level = grouping.code[rows, None] == np.arange(levels)
        matrices.append(of_level * column.covariate[rows, None])
        pieces.append(EffectPart(term.effect(part.response), levels, 0.0, None, term.sd(part.response)))
    return np.concatenate(matrices, axis=1), pieces


def shared_mass_errors(
    locations: EffectParts, design: PopulationDesign, b: Float[Array, "*draw location"]
) -> Float[Array, "*draw impact"]:
    """Each impact's error of log mass, where impacts share these: it is part of b."""
    where = locations.parts[MASS_ERROR]
    alone = jnp.zeros_like(b).at[..., where].set(b[..., where])
    return -expected(design, alone)[0]


def force_ratio(locations: EffectParts) -> int:
    """Which element of b is the common log of force over mass times deceleration; of no force any."""
    part = locations.parts.get(intercept("log_force_ratio"))
    return 0 if part is None else part.start


def heavier(
    locations: EffectParts,
    b: Float[np.ndarray, "*draw location"],
    log_factor: Float[np.ndarray, "*draw"],
    parameters: Sequence[str] = RESPONSES,
) -> Float[np.ndarray, "*draw location"]:
    """Effects with K, C and what else goes with the mass, of so much heavier impactors.

    Args:
        locations: what b is made of.
        b: effects at the declared masses.
        log_factor: of the masses.
        parameters: those in proportion to the mass, as `parameter_of` names them.
    """
    if not log_factor.any():
        return b
    moved = np.array(b)
    for parameter in parameters:
        moved[..., locations.parts[intercept(parameter)].start] += log_factor
    return moved


def covariances_of(
    locations: EffectParts, hyperparameters: Hyperparameters, log_mass_sd: float, nuisance: tuple[str, ...]
) -> Covariances:
    """The covariances that the hyperparameters imply.

    An error of the log mass, with standard deviation ``log_mass_sd``, moves log K and log C alike. Each
    impact's own is part of how u scatters about X b, and needs no parameter of its own; one that several
    impacts share is part of b.

    Args:
        locations: what the elements of b are.
        hyperparameters: the standard deviations, and ``residual_correlation`` where it is not 0.
        log_mass_sd: standard deviation of the error of log mass.
        nuisance: names of an impact's parameters besides log K and log C.
    """
    sd_K, sd_C = hyperparameters["sd_impact_K"], hyperparameters["sd_impact_C"]
    correlation = hyperparameters.get("residual_correlation", jnp.zeros_like(sd_K))
    error = 0.0 if locations.of_shared_masses else log_mass_sd**2
    pair = (sd_K**2 + error, correlation * sd_K * sd_C + error, sd_C**2 + error)

    def sd_of(part: EffectPart) -> Any:
        if part.name == MASS_ERROR:
            return log_mass_sd
        return hyperparameters[part.spread] if part.sd is None else part.sd

    sd = jnp.concatenate([jnp.full(part.width, sd_of(part)) for part in locations.blocks])
    return Covariances(pair, tuple(hyperparameters[f"sd_{name}"] for name in nuisance), sd)
