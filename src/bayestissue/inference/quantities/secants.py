"""Mass exponents of the force over depth: at one depth that all impacts reach, and at each one's greatest.

Beside a discrepancy the K of the hierarchy is that at each impact's greatest depth. There conditions differ
by other amounts than at one depth: on a tissue that stiffens, a stiffer condition is pressed less deep, and
its secant stiffness differs by less. What conditions leave open of an exponent is then found from the
impacts' own force over depth at the one depth.

The K that the hierarchy samples beside a discrepancy is the element's own part of the force, which no
measurement knows, and its interval may hold neither the tissue's tangent nor its secant. What can be said of
the tissue is force over depth, which of a spring beside a damper is the spring's K.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.inference.execution.kept import some_impacts
from bayestissue.inference.quantities.elements import COMMON_DEPTH
from bayestissue.inference.samplers.sampling import ConstrainedDraws

# By what it is called: what of an impact it is the exponent of.
EXPONENTS = {f"mass_exponent_{COMMON_DEPTH}": COMMON_DEPTH, "mass_exponent_K_secant": "K_secant"}
_SPREADS = np.geomspace(1e-4, 10.0, 500)


def mass_exponents_of_secants(
    prepared: Prepared, constrained: ConstrainedDraws, seed: int
) -> dict[str, Float[np.ndarray, "chain draw"]]:
    """Slopes on log mass, all else equal, of log K_common_depth and log K_secant.

    Without a discrepancy, in each draw the exponent of the element's own K, and added to it the least-squares
    slope of log(K_common_depth / K) over the impacts, covariates beside it. With one K is K_secant already,
    and at the common depth it is the slope over the conditions, each draw with an error of its own for what
    conditions scatter there: see `slope_over_units`.

    Args:
        prepared: the fit.
        constrained: draws of everything; with a discrepancy as `of_secant` returns them.
        seed: of these draws.

    Returns:
        `EXPONENTS`, of all draws or of those that are kept of impacts; nothing where stiffness does not
        depend on depth, or log K has no exponent. A stiffness that a draw has at or below 0, as one may where
        the damper's part of the force is hardly known, has none.
    """
    design, impacts = prepared.design, constrained.impacts
    if COMMON_DEPTH not in impacts or design.responses["K"].log_mass is None:
        return {}
    which = slice(None) if constrained.kept_numbers is None else constrained.kept_numbers
    positive = {name: secant for name, secant in EXPONENTS.items() if (impacts[secant] > 0).all()}
    sites = {name: values[:, which] for name, values in constrained.sites.items() if name.endswith("_K")}
    moved = {
        name: sites | shifted(design, sites, np.log(impacts[secant] / impacts["K"]))
        for name, secant in positive.items()
    }
    exponents = {name: values["mass_exponent_K"] for name, values in moved.items()}
    name = f"mass_exponent_{COMMON_DEPTH}"
    if prepared.model.discrepancy and name in exponents:
        units = units_of(design, moved[name], np.log(impacts[COMMON_DEPTH]))
        prior = prepared.model.priors.mass_exponent.K
        log_prior = np.asarray(prepared.model.prior_of(f"sd_{units.name}_K").log_prob(_SPREADS))
        rng = np.random.default_rng([seed, 31])
        exponents[name] = slope_over_units(units, (prior.mean, prior.sd), log_prior, rng)
    return exponents


class Units(NamedTuple):
    """The conditions, people or impacts between which mass varies.

    Attributes:
        name: "trial", "subject" or "impact".
        log_mass: of each.
        levels: log K of each, covariates and the other groups' effects taken off.
    """

    name: str
    log_mass: Float[np.ndarray, " unit"]
    levels: Float[np.ndarray, "chain draw unit"]


def units_of(
    design: Design, sites: dict[str, np.ndarray], logs: Float[np.ndarray, "chain draw impact"]
) -> Units:
    """A unit's level is the mean over its impacts of ``logs``; its group's effects are part of it.

    Args:
        design: of log K, with a mass exponent.
        sites: coefficients and effects of ``logs``.
        logs: of each impact.
    """
    part = design.responses["K"]
    log_mass = part.log_mass
    assert log_mass is not None  # noqa: S101 - else there is no exponent
    name = next((group for group in ("trial", "subject") if _varies_between(design, group)), "impact")
    if part.names:
        logs = logs - sites["covariate_effect_K"][..., : len(part.names)] @ part.covariates.T
    for term, column in part.terms.items():
        if term.grouping != name or term.slope:
            code = design.groupings[term.grouping].code
            logs = logs - sites[term.effect("K")][..., code] * column.covariate
    if name == "impact":
        return Units(name, log_mass, logs)
    codes = design.groupings[name].code
    member = (codes[:, None] == np.unique(codes)).astype(float)
    member /= member.sum(0)
    return Units(name, log_mass @ member, logs @ member)


def _varies_between(design: Design, group: str) -> bool:
    """Whether the formula of K has the group's effects, and each of the group is of one mass."""
    part, codes = design.responses["K"], design.groupings[group].code
    first = np.unique(codes, return_index=True)[1]
    return (
        group in part.groups
        and part.log_mass is not None
        and bool((part.log_mass == part.log_mass[first][codes]).all())
    )


def slope_over_units(
    units: Units,
    exponent: tuple[float, float],
    log_prior_of_spread: Float[np.ndarray, " spread"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "chain draw"]:
    """The slope b of y_j = a + b m_j + e_j, e_j ~ N(0, s^2), whose y are known as draws have them.

    The levels' mean over the draws is N(a + b m, S + s^2 1), S being the draws' covariance. With flat priors
    of a and b, p(s | y) is in proportion to p(s) prod_i (l_i + s^2)^(-1/2) exp(-r_i^2 / (2 (l_i + s^2))),
    with the eigenvalues l of S beside 1 and m, and r what of the mean lies along its eigenvectors (restricted
    maximum likelihood: Patterson and Thompson 1971, doi:10.1093/biomet/58.3.545). In each draw b is the
    least-squares slope of its levels and an error of variance s^2 / S_mm, with b's prior.

    Args:
        units: y and m.
        exponent: mean and standard deviation of b's normal prior.
        log_prior_of_spread: log p(s) on the grid of this module.
        rng: of the draws.
    """
    levels, m = units.levels, units.log_mass - units.log_mass.mean()
    squares, slope = float(m @ m), levels @ m / float(m @ m)
    log_density = log_prior_of_spread + np.log(_SPREADS) + _restricted(units)
    below = np.cumsum(np.exp(log_density - log_density.max()))
    spread = _SPREADS[np.searchsorted(below, rng.uniform(size=slope.shape) * below[-1])]
    (mean, sd), precision = exponent, squares / spread**2
    centre = (precision * slope + mean / sd**2) / (precision + 1 / sd**2)
    return centre + rng.standard_normal(slope.shape) / np.sqrt(precision + 1 / sd**2)


def _restricted(units: Units) -> Float[np.ndarray, " spread"]:
    """Log of the restricted likelihood of the units' spread on the grid, from a thousand units at most."""
    rows = some_impacts(len(units.log_mass))
    if len(rows) < 3:
        return np.zeros_like(_SPREADS)
    drawn = units.levels[..., rows].reshape(-1, len(rows))
    line = np.column_stack([np.ones(len(rows)), units.log_mass[rows]])
    complement = np.linalg.qr(line, mode="complete").Q[:, 2:]
    known, along = np.linalg.eigh(np.atleast_2d(np.cov(drawn @ complement, rowvar=False)))
    left = (drawn.mean(0) @ complement) @ along
    variance = known[:, None] + _SPREADS**2
    return -(np.log(variance) + left[:, None] ** 2 / variance).sum(0) / 2


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
    if not model.discrepancy or constrained.kept_numbers is not None:
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
    moved = {name: sites[name] + line[..., number] for number, name in enumerate(names)}
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
