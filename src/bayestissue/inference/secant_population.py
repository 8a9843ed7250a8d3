"""K as the secant stiffness: of the population where a discrepancy acts, and its mass exponents at one depth.

With another force beside the element's, the K that the hierarchy samples is the element's own part of the
force, which no measurement knows, and its interval may hold neither the tissue's tangent nor its secant. What
can be said of the tissue is force over depth, which of a spring beside a damper is the spring's K.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.inference.element_draws import COMMON_DEPTH
from bayestissue.inference.trace_draws import Unfolded

# By what it is called: what of an impact it is the exponent of.
EXPONENTS_OF_SECANTS = {
    f"mass_exponent_{COMMON_DEPTH}": COMMON_DEPTH,
    "mass_exponent_K_secant": "K_secant",
}


def of_secant(prepared: Prepared, unfolded: Unfolded) -> Unfolded:
    """Draws in which K means the secant stiffness, of impacts and of the population.

    In each draw log(K_secant / K) of the impacts is laid out over log K's formula: its least-squares line
    goes to intercept, mass exponent and covariates, and what is left, averaged, to people and then to
    conditions. The spreads stay. What the element's own K makes at contact is K_tangent.

    Args:
        prepared: the fit; without a discrepancy draws stay as they are.
        unfolded: draws of everything, all of every impact.
    """
    model = prepared.model
    if not model.discrepancy or unfolded.kept is not None:
        return unfolded
    impacts = unfolded.impacts
    shift = np.log(impacts["K_secant"] / impacts["K"])
    sites = unfolded.sites | shifted(prepared.design, unfolded.sites, shift)
    return replace(unfolded, sites=sites, impacts={**impacts, "K": impacts["K_secant"]})


def mass_exponents_of_secants(design: Design, unfolded: Unfolded) -> dict[str, np.ndarray]:
    """Mass exponents of the force over depth, at one common depth and at each impact's greatest depth.

    In each draw K's exponent and the least-squares slope on log mass, covariates beside it, of
    log(K_common_depth / K) or of log(K_secant / K) over the impacts, as in `of_secant`. What people and
    conditions leave open of K's exponent is thus left open of these.

    Args:
        design: with the formula of log K.
        unfolded: draws of everything, before or after `of_secant`.

    Returns:
        `EXPONENTS_OF_SECANTS`, [chain, draw], or those draws that are kept of impacts; nothing where impacts
        have no ``K_common_depth``, or K no mass exponent.
    """
    impacts, sites = unfolded.impacts, unfolded.sites
    if COMMON_DEPTH not in impacts or design.responses["K"].log_mass is None:
        return {}
    which = slice(None) if unfolded.kept is None else unfolded.kept
    exponent = sites["mass_exponent_K"][:, which]
    return {
        name: exponent + line_of(design, np.log(impacts[secant] / impacts["K"]))[0][..., 1]
        for name, secant in EXPONENTS_OF_SECANTS.items()
    }


def line_of(
    design: Design, shift: Float[np.ndarray, "chain draw impact"]
) -> tuple[Float[np.ndarray, "chain draw coefficient"], Float[np.ndarray, "impact coefficient"]]:
    """The least-squares line of each draw's shift over log K's formula, and the formula's matrix.

    Coefficients are those of the intercept, of log mass if the formula has it, and of covariates.
    """
    part = design.responses["K"]
    columns = [np.ones(shift.shape[-1]), *([part.log_mass] if part.log_mass is not None else [])]
    matrix = np.column_stack([*columns, part.covariates])
    return shift @ np.linalg.pinv(matrix).T, matrix


def shifted(
    design: Design, sites: dict[str, np.ndarray], shift: Float[np.ndarray, "chain draw impact"]
) -> dict[str, np.ndarray]:
    """The sites of log K with each impact's shift laid out over them."""
    part = design.responses["K"]
    names = ["intercept_K", *(["mass_exponent_K"] if part.log_mass is not None else [])]
    line, matrix = line_of(design, shift)
    moved = {name: sites[name] + line[..., place] for place, name in enumerate(names)}
    if part.names:
        moved["covariate_effect_K"] = sites["covariate_effect_K"] + line[..., len(names) :]
    left = shift - line @ matrix.T
    for group in part.groups:
        codes = getattr(design, group)
        member = (codes[:, None] == np.arange(len(getattr(design, f"{group}s")))).astype(float)
        mean = left @ (member / member.sum(0))
        moved[f"{group}_effect_K"] = sites[f"{group}_effect_K"] + mean
        left = left - mean[..., codes]
    return moved
