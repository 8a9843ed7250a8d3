"""K as the secant stiffness, where a discrepancy acts beside the element.

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
from bayestissue.inference.samplers.sampling import ConstrainedDraws


def of_secant(prepared: Prepared, constrained: ConstrainedDraws) -> ConstrainedDraws:
    """Draws in which K means the secant stiffness, of impacts and of the population.

    In each draw log(K_secant / K) of the impacts is laid out over log K's formula: its least-squares line
    goes to intercept, mass exponent and covariates, and what is left, averaged, to people, then to
    conditions, and so on through the formula's group terms. The spreads stay. What the element's own K makes
    at contact is K_tangent.

    Args:
        prepared: the fit; without a discrepancy draws stay as they are.
        constrained: draws of everything, all of every impact.
    """
    model = prepared.model
    if not model.discrepancy or constrained.kept is not None:
        return constrained
    impacts = constrained.impacts
    shift = np.log(impacts["K_secant"] / impacts["K"])
    sites = constrained.sites | shifted(prepared.design, constrained.sites, shift)
    return replace(constrained, sites=sites, impacts={**impacts, "K": impacts["K_secant"]})


def shifted(
    design: Design, sites: dict[str, np.ndarray], shift: Float[np.ndarray, "chain draw impact"]
) -> dict[str, np.ndarray]:
    """The sites of log K with each impact's shift laid out over them."""
    part = design.responses["K"]
    names = ["intercept_K", *(["mass_exponent_K"] if part.log_mass is not None else [])]
    columns = [np.ones(shift.shape[-1]), *([part.log_mass] if part.log_mass is not None else [])]
    matrix = np.column_stack([*columns, part.covariates])
    line = shift @ np.linalg.pinv(matrix).T
    moved = {name: sites[name] + line[..., place] for place, name in enumerate(names)}
    if part.names:
        moved["covariate_effect_K"] = sites["covariate_effect_K"] + line[..., len(names) :]
    left = shift - line @ matrix.T
    for term, column in part.terms.items():
        grouping = design.groupings[term.grouping]
        member = (grouping.code[:, None] == np.arange(len(grouping.levels))) * column.covariate[:, None]
        # Of an intercept the levels' means; a level in which the covariate is always zero keeps its own.
        slope = left @ (member / np.maximum((member**2).sum(0), np.finfo(float).tiny))
        moved[term.effect("K")] = sites[term.effect("K")] + slope
        left = left - slope[..., grouping.code] * column.covariate
    return moved
