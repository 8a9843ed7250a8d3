"""The hierarchy over impacts as matrices: what b, all location parameters together, says of each impact.

An impact's own parameters are u = (log K, log C, log noise[, artanh theta1]), K and C at the recorded mass.
Given b and the standard deviations, u is normal about X b; b is normal too. Subject and trial effects,
intercepts, mass exponents and covariates are all parts of b, so everything linear is one vector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.hierarchy.design import Design, ResponseDesign
from bayestissue.hierarchy.effects import RESPONSES
from bayestissue.hierarchy.formula import GROUPS
from bayestissue.hierarchy.gaussian.arrangement import PopulationDesign, arrange, expected
from bayestissue.hierarchy.gaussian.covariances import Covariances, SharedMassError
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


def population_design(
    design: Design, priors: Priors, nuisance: tuple[str, ...]
) -> tuple[Effects, PopulationDesign]:
    """Arrange a design: b is (all of log K's, all of log C's, then one mean per nuisance parameter).

    Args:
        design: the formulas evaluated over the impacts.
        priors: of which those of the parts of b are read.
        nuisance: names of an impact's parameters besides log K and log C.

    Returns:
        What the elements of b are, and X with rows that repeat kept once, arranged for elimination.
    """
    design, row = _distinct_rows(design)
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
    whole = np.concatenate(rows, axis=1)
    _, first, cell = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    found = Effects(parts, np.array(mean, float), np.array(sd, float), tuple(spread))
    groups = [part for part in parts.values() if spread[part.start]]
    return found, arrange([matrix[first] for matrix in rows], cell.reshape(-1)[row], groups)


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


def of_impacts(
    design: PopulationDesign, covariances: Covariances, values: Float[Array, " person"]
) -> Float[Array, " impact"]:
    """Each impact's person's value, where people share an error of mass."""
    assert covariances.shared is not None  # noqa: S101 - the callers ask
    alone = jnp.zeros(len(covariances.locations)).at[covariances.shared.effect_on_K].set(values)
    return expected(design, alone)[0]


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
