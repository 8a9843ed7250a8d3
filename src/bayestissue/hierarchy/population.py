"""The hierarchy over impacts as matrices: what b, all location parameters together, says of each impact.

An impact's own parameters are u = (log K, log C, log noise[, artanh theta1]), K and C at the recorded mass.
Given b and the standard deviations, u is normal about X b; b is normal too. Subject and trial effects,
intercepts, mass exponents and covariates are all parts of b, so everything linear is one vector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from bayestissue.hierarchy.design import Design, ResponseDesign
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.priors import Priors

MassError = Literal["impact", "subject"]


@dataclass(frozen=True)
class Effects:
    """Names and places of the parts of b.

    ``parts`` has the slice of each part, such as ``intercept_K`` or ``subject_effect_C``; ``mean`` and
    ``sd`` [location] are the prior's, with NaN for the sd of an effect whose spread is itself unknown,
    named in ``spread`` [location].
    """

    parts: dict[str, slice]
    mean: np.ndarray
    sd: np.ndarray
    spread: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of elements of b."""
        return len(self.mean)


class PopulationDesign(NamedTuple):
    """Design matrices over cells, the distinct rows of the design, and the cell of every impact.

    Attributes:
        columns: one matrix per parameter of an impact, [cell, that parameter's part of b].
        cell: of each impact.
    """

    columns: tuple[Float[np.ndarray | Array, "cell part"], ...]
    cell: Int[np.ndarray | Array, " impact"]


def population_design(
    design: Design, priors: Priors, nuisance: tuple[str, ...]
) -> tuple[Effects, PopulationDesign]:
    """Arrange a design: b is (all of log K's, all of log C's, then one mean per nuisance parameter).

    Args:
        design: the formulas evaluated over the impacts.
        priors: of which those of the parts of b are read.
        nuisance: names of an impact's parameters besides log K and log C.

    Returns:
        What the elements of b are, and the matrices X with rows that repeat kept once.
    """
    number = len(design.subject)
    design, row = _distinct_rows(design)
    effects, rows = effects_of(design, priors, nuisance)
    whole = np.concatenate(rows, axis=1)
    _, first, cell = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    cell = cell.reshape(-1)[row]
    if len(first) == number:
        first, cell = row, np.arange(number)
    return effects, PopulationDesign(tuple(matrix[first] for matrix in rows), cell)


def effects_of(
    design: Design, priors: Priors, nuisance: tuple[str, ...]
) -> tuple[Effects, list[Float[np.ndarray, "row part"]]]:
    """What the elements of b are, and of each parameter its columns of X, row by row of the design."""
    parts: dict[str, slice] = {}
    rows: list[np.ndarray] = []
    mean: list[float] = []
    sd: list[float] = []
    spread: list[str] = []
    for response in RESPONSES:
        matrix, pieces = _response(design, design.responses[response], response, priors)
        for name, width, prior_mean, prior_sd, unknown in pieces:
            parts[name] = slice(len(mean), len(mean) + width)
            mean += [prior_mean] * width
            sd += [prior_sd] * width
            spread += [unknown] * width
        rows.append(matrix)
    for name in nuisance:
        prior = priors.of_mean(name)
        parts[f"{name}_mean"] = slice(len(mean), len(mean) + 1)
        mean.append(prior.mean)
        sd.append(prior.sd)
        spread.append("")
        rows.append(np.ones((len(design.subject), 1)))
    return Effects(parts, np.array(mean, float), np.array(sd, float), tuple(spread)), rows


def _distinct_rows(design: Design) -> tuple[Design, np.ndarray]:
    """The design with rows that repeat kept once, and of each row the one that is kept.

    One column for a hundred people here, where the matrices need a hundred.
    """
    keys = [design.subject, design.trial]
    for part in design.responses.values():
        keys += [*part.covariates.T, *([] if part.log_mass is None else [part.log_mass])]
    _, first, row = np.unique(np.stack(keys, axis=1), axis=0, return_index=True, return_inverse=True)
    responses = {
        name: replace(
            part,
            covariates=part.covariates[first],
            log_mass=None if part.log_mass is None else part.log_mass[first],
        )
        for name, part in design.responses.items()
    }
    kept = replace(design, responses=responses, subject=design.subject[first], trial=design.trial[first])
    return kept, row.reshape(-1)


def _response(
    design: Design, part: ResponseDesign, response: str, priors: Priors
) -> tuple[np.ndarray, list[tuple[str, int, float, float, str]]]:
    count = len(design.subject)
    matrices = [np.ones((count, 1))]
    intercept = getattr(priors.intercept, response)
    pieces = [(f"intercept_{response}", 1, intercept.mean, intercept.sd, "")]
    if part.log_mass is not None:
        exponent = getattr(priors.mass_exponent, response)
        matrices.append(part.log_mass[:, None])
        pieces.append((f"mass_exponent_{response}", 1, exponent.mean, exponent.sd, ""))
    if part.names:
        covariate = getattr(priors.covariate, response)
        matrices.append(part.covariates)
        pieces.append((f"covariate_effect_{response}", len(part.names), covariate.mean, covariate.sd, ""))
    for group in GROUPS:
        if group in part.groups:
            codes = getattr(design, group)
            levels = len(getattr(design, f"{group}s"))
            matrices.append((codes[:, None] == np.arange(levels)).astype(float))
            pieces.append((f"{group}_effect_{response}", levels, 0.0, np.nan, f"sd_{group}_{response}"))
    return np.concatenate(matrices, axis=1), pieces


class SharedMassError(NamedTuple):
    """The error of a person's mass, which moves the person's log K and log C in every impact alike.

    Attributes:
        effect_on_K: elements of b that are a person's effects on log K.
        effect_on_C: those on log C.
        variance: of the error of log mass.
    """

    effect_on_K: Int[np.ndarray | Array, " person"]
    effect_on_C: Int[np.ndarray | Array, " person"]
    variance: Float[Array, ""] | float


class Covariances(NamedTuple):
    """Covariance of an impact's parameters about X b, and the standard deviations of b's elements.

    Attributes:
        own: of (log K, log C) at the recorded mass, as (KK, KC, CC).
        nuisance: standard deviation of each nuisance parameter between impacts.
        locations: prior standard deviation of each element of b, a shared error left out.
        shared: the error of mass that a person's two effects share, where the mass is a person's own; b's
            effects of people are then those at the recorded mass.
    """

    own: tuple[Array, Array, Array]
    nuisance: tuple[Array, ...]
    locations: Float[Array, " location"]
    shared: SharedMassError | None = None

    def precision(self) -> tuple[Float[Array, " location"], Float[Array, " person"] | None]:
        """Prior precision of b: its diagonal, and the entries between a person's two effects."""
        diagonal = self.locations**-2.0
        if self.shared is None:
            return diagonal, None
        on_K, on_C, variance = self.shared
        K, C, determinant = self._pairs()
        diagonal = diagonal.at[on_K].set((C + variance) / determinant)
        return diagonal.at[on_C].set((K + variance) / determinant), -variance / determinant

    def weigh(self, values: Float[Array, " location"]) -> Float[Array, " location"]:
        """The prior precision of b times ``values``."""
        diagonal, between = self.precision()
        weighed = diagonal * values
        if self.shared is None or between is None:
            return weighed
        on_K, on_C, _ = self.shared
        return weighed.at[on_K].add(between * values[on_C]).at[on_C].add(between * values[on_K])

    def precision_matrix(self) -> Float[Array, "location location"]:
        """The same as a matrix."""
        diagonal, between = self.precision()
        matrix = jnp.diag(diagonal)
        if self.shared is None:
            return matrix
        on_K, on_C, _ = self.shared
        return matrix.at[on_K, on_C].set(between).at[on_C, on_K].set(between)

    def log_scale(self) -> Float[Array, ""]:
        """Half the log determinant of b's prior covariance."""
        alone = jnp.log(self.locations).sum()
        if self.shared is None:
            return alone
        K, C, determinant = self._pairs()
        return alone + jnp.log(determinant / (K * C)).sum() / 2

    def _pairs(self) -> tuple[Array, Array, Array]:
        """Of each person: the variances of the own effects, and the covariance's determinant."""
        assert self.shared is not None  # noqa: S101 - the callers ask
        K, C = self.locations[self.shared.effect_on_K] ** 2, self.locations[self.shared.effect_on_C] ** 2
        return K, C, K * C + self.shared.variance * (K + C)


def covariances_of(
    locations: Effects,
    sites: dict[str, Array],
    log_mass_sd: float,
    nuisance: tuple[str, ...],
    mass_error: MassError = "impact",
) -> Covariances:
    """The covariances that the sampled standard deviations imply.

    An error of the log mass, with standard deviation ``log_mass_sd``, moves log K and log C alike. Being
    part of how u scatters about X b, or of how people's effects scatter about 0, it needs no parameter of
    its own.

    Args:
        locations: what the elements of b are.
        sites: the sampled standard deviations, and ``residual_correlation`` where it is not 0.
        log_mass_sd: standard deviation of the error of log mass.
        nuisance: names of an impact's parameters besides log K and log C.
        mass_error: whether each impact has an error of its own or all of a person's impacts the same.
    """
    sd_K, sd_C = sites["sd_impact_K"], sites["sd_impact_C"]
    correlation = sites.get("residual_correlation", jnp.zeros_like(sd_K))
    error = log_mass_sd**2 if mass_error == "impact" else 0.0
    own = (sd_K**2 + error, correlation * sd_K * sd_C + error, sd_C**2 + error)
    known = jnp.asarray(np.nan_to_num(locations.sd, nan=1.0))
    sd = known
    for name in sorted({name for name in locations.spread if name}):
        chosen = np.array([each == name for each in locations.spread])
        sd = jnp.where(chosen, sites[name], sd)
    shared = None
    if mass_error == "subject":
        on_K, on_C = (np.r_[locations.parts[f"subject_effect_{q}"]] for q in RESPONSES)
        shared = SharedMassError(on_K, on_C, log_mass_sd**2)
    return Covariances(own, tuple(sites[f"sd_{name}"] for name in nuisance), sd, shared)


def expected(design: PopulationDesign, b: Float[Array, " location"]) -> list[Float[Array, " impact"]]:
    """X b: the expectation of each of an impact's parameters.

    Args:
        design: X over cells.
        b: all location parameters.
    """
    values, begin = [], 0
    for matrix in design.columns:
        end = begin + matrix.shape[1]
        values.append((jnp.asarray(matrix) @ b[begin:end])[design.cell])
        begin = end
    return values


def of_impacts(
    design: PopulationDesign, shared: SharedMassError, values: Float[Array, " person"]
) -> Float[Array, " impact"]:
    """Each impact's person's value.

    Args:
        design: X over cells, which has a column for every person.
        shared: where these columns are; those of log K begin b.
        values: one a person.
    """
    return (jnp.asarray(design.columns[0])[:, shared.effect_on_K] @ values)[design.cell]
