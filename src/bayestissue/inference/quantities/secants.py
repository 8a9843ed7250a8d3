"""Secant stiffness: of impacts together, and its mass exponents at two depths.

The depths are each impact's greatest one, and one that all impacts reach.

The K that the hierarchy samples is the element's own. Beside a discrepancy that is the element's part of the
force, which no measurement knows, and its interval may hold neither the tissue's tangent nor its secant
stiffness. What can be said of the tissue is force over depth, which of a spring beside a damper is the
spring's K: at each impact's greatest depth (K_secant), and at one depth that all impacts reach
(K_common_depth). On a tissue that stiffens these have other mass exponents: a stiffer condition is pressed
less deep, and its secant stiffness differs by less.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayestissue.base.impact_arrays import PerDraw
from bayestissue.inference.execution.kept import some_impacts
from bayestissue.inference.quantities.impact_quantities import COMMON_DEPTH
from bayestissue.inference.quantities.quantity_draws import Draws
from bayestissue.model.hierarchy.design import Design
from bayestissue.model.hierarchy.formulas.group_terms import stem_of
from bayestissue.model.hierarchy.trace_data import Prepared

# By what it is called: what of an impact it is the exponent of.
EXPONENTS = {f"mass_exponent_{COMMON_DEPTH}": COMMON_DEPTH, "mass_exponent_K_secant": "K_secant"}
_SPREADS = np.geomspace(1e-4, 10.0, 500)
# The draws of an impact that each is made of. On a spring and damper side by side the secant stiffness is K
# itself, and C is the equivalent damping.
_SOURCES = {"K_secant": ("K_secant", "K"), "C_equivalent": ("C_equivalent", "C")}
OF_IMPACTS = tuple(f"{name}_of_impacts" for name in _SOURCES)
OF_PEOPLE = tuple(f"{name}_of_subject" for name in _SOURCES)


def mass_exponents_of_secants(prepared: Prepared, draws: Draws, seed: int) -> dict[str, PerDraw]:
    """Slopes on log mass, all else equal, of log K_common_depth and log K_secant.

    Without a discrepancy the element's law is the tissue's: in each draw the exponent of K, and added to it
    the least-squares slope of log(K_common_depth / K) over the impacts, covariates beside it. With one, each
    has a model of its own, whatever the hierarchy of K: the levels of the units between which mass varies
    (`units_of`) lie about a straight line in log mass, with normal scatter (`slope_over_units`). Exponent and
    scatter have the priors of K's.

    Args:
        prepared: the fit.
        draws: of everything.
        seed: of these draws.

    Returns:
        `EXPONENTS`, of all draws or of those that are kept of impacts; nothing where stiffness does not
        depend on depth, or log K has no exponent. A stiffness that a draw has at or below 0, as one may where
        the damper's part of the force is hardly known, has none.
    """
    design, model, impacts = prepared.design, prepared.model, draws.impacts
    part = design.responses["K"]
    if COMMON_DEPTH not in impacts or part.log_mass is None:
        return {}
    positive = {name: impacts[secant] for name, secant in EXPONENTS.items() if (impacts[secant] > 0).all()}
    if not model.discrepancy:
        which = slice(None) if draws.kept_numbers is None else draws.kept_numbers
        exponent = draws.population["mass_exponent_K"][:, which]
        line = np.column_stack([np.ones_like(part.log_mass), part.log_mass, part.covariates])
        slope = np.linalg.pinv(line)[1]
        return {name: exponent + np.log(secant / impacts["K"]) @ slope for name, secant in positive.items()}
    rng, prior, exponents = np.random.default_rng([seed, 31]), model.priors.mass_exponent.K, {}
    for name, secant in positive.items():
        units = units_of(design, np.log(secant))
        of_spread = np.asarray(model.prior_of(f"sd_{stem_of(units.name)}_K").log_prob(_SPREADS))
        exponents[name] = slope_over_units(units, (prior.mean, prior.sd), of_spread, rng)
    return exponents


class Units(NamedTuple):
    """The conditions, people, levels of another group, or impacts between which mass varies.

    Attributes:
        name: "trial", "subject", another grouping, or "impact".
        log_mass: of each.
        levels: log K of each, what differs within them taken off.
        others: what of the formula differs between them besides.
    """

    name: str
    log_mass: Float[np.ndarray, " unit"]
    levels: Float[np.ndarray, "chain draw unit"]
    others: Float[np.ndarray, "unit column"]


def units_of(design: Design, logs: Float[np.ndarray, "chain draw impact"]) -> Units:
    """The group with the fewest levels whose levels are of one mass each, else the impacts themselves.

    A level of it is the mean of ``logs`` over its impacts, covariates and levels of other groups taken off
    as least squares finds them within the units; covariates that differ between units alone are left to them.

    Args:
        design: of log K, with a mass exponent.
        logs: of each impact.
    """
    part, groupings = design.responses["K"], design.groupings
    log_mass = part.log_mass
    assert log_mass is not None  # noqa: S101 - else there is no exponent
    of_one_mass = [name for name in part.groups if _constant_within(groupings[name].code, log_mass)]
    name = min(of_one_mass, key=lambda name: len(groupings[name].levels), default="impact")
    effects = [
        (groupings[term.grouping].code[:, None] == np.arange(len(groupings[term.grouping].levels)))
        * column.covariate[:, None]
        for term, column in part.terms.items()
        if term.grouping != name or term.slope
    ]
    others = np.column_stack([part.covariates, *effects])
    if name == "impact":
        return Units(name, log_mass, logs, others)
    code = groupings[name].code
    member = (code[:, None] == np.unique(code)).astype(float)
    _, fitted = _beside(member, others)
    member /= member.sum(0)
    between = [column for column in part.covariates.T if _constant_within(code, column)]
    levels = (logs - (logs @ fitted.T) @ others.T) @ member
    return Units(name, log_mass @ member, levels, (np.reshape(between, (-1, len(code))) @ member).T)


def _constant_within(code: np.ndarray, values: np.ndarray) -> bool:
    return bool((values == values[np.unique(code, return_index=True)[1]][code]).all())


def _beside(line: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of the columns ``others`` is across those of ``line``, and the rows that fit it to values."""
    across = others - line @ np.linalg.solve(line.T @ line, line.T @ others)
    # Levels of several groups add up to the same constant: of all solutions the least.
    return across, np.linalg.pinv(across.T @ across, rcond=1e-10, hermitian=True) @ across.T


def slope_over_units(
    units: Units,
    exponent: tuple[float, float],
    log_prior_of_spread: Float[np.ndarray, " spread"],
    rng: np.random.Generator,
) -> PerDraw:
    """The slope b of y_j = a + b m_j + c x_j + e_j, e_j ~ N(0, s^2), whose y are known as draws have them.

    The levels' mean over the draws is N(a + b m + c x, S + s^2 1), S being the draws' covariance. With flat
    priors of a, b and c, p(s | y) is in proportion to p(s) prod_i (l_i + s^2)^(-1/2)
    exp(-r_i^2 / (2 (l_i + s^2))), with the eigenvalues l of S beside 1, m and x, and r what of the mean lies
    along its eigenvectors (restricted maximum likelihood: Patterson and Thompson 1971,
    doi:10.1093/biomet/58.3.545). In each draw b is the least-squares slope w'y of its levels and an error of
    variance s^2 w'w, with b's prior.

    Args:
        units: y, m and x.
        exponent: mean and standard deviation of b's normal prior.
        log_prior_of_spread: log p(s) on the grid of this module.
        rng: of the draws.
    """
    line = np.column_stack([np.ones_like(units.log_mass), units.log_mass])
    across, fitted = _beside(line, units.others)
    weight = np.linalg.pinv(line)[1]
    weight = weight - (weight @ units.others) @ fitted
    slope = units.levels @ weight
    restricted = _restricted(np.column_stack([line, across]), units.levels)
    log_density = log_prior_of_spread + np.log(_SPREADS) + restricted
    below = np.cumsum(np.exp(log_density - log_density.max()))
    spread = _SPREADS[np.searchsorted(below, rng.uniform(size=slope.shape) * below[-1])]
    (mean, sd), precision = exponent, 1 / (spread**2 * (weight @ weight))
    centre = (precision * slope + mean / sd**2) / (precision + 1 / sd**2)
    return centre + rng.standard_normal(slope.shape) / np.sqrt(precision + 1 / sd**2)


def _restricted(
    line: Float[np.ndarray, "unit column"], levels: Float[np.ndarray, "chain draw unit"]
) -> Float[np.ndarray, " spread"]:
    """Log of the restricted likelihood of the units' spread on the grid, from a thousand units at most."""
    from scipy.linalg import null_space

    rows = some_impacts(len(line))
    complement = null_space(line[rows].T)
    if not complement.shape[1]:
        return np.zeros_like(_SPREADS)
    drawn = levels[..., rows].reshape(-1, len(rows))
    known, along = np.linalg.eigh(np.atleast_2d(np.cov(drawn @ complement, rowvar=False)))
    left = (drawn.mean(0) @ complement) @ along
    variance = known[:, None] + _SPREADS**2
    return -(np.log(variance) + left[:, None] ** 2 / variance).sum(0) / 2


def comparable_draws(posterior: xr.Dataset, groups: Mapping[str, np.ndarray]) -> dict[str, xr.DataArray]:
    """Stiffness and damping that mean the same for every element, of these impacts and of groups of them.

    The geometric means over all recorded impacts, and over those of each level of a grouping, of the secant
    stiffness and of the equivalent damping: for K, exp((1/n) sum_i log K_secant,i), by draw.

    Args:
        posterior: with "K" and "C" [chain, draw or kept draw, impact], and "K_secant" and "C_equivalent"
            where the run's element has them. Nothing comes of a run without single impacts.
        groups: [impact], each impact's level, by grouping, such as whose it is, by "subject".

    Returns:
        By name, such as "K_secant_of_impacts" [chain, draw] or "K_secant_of_subject" [chain, draw, subject].
    """
    comparable: dict[str, xr.DataArray] = {}
    for name, sources in _SOURCES.items():
        source = next((candidate for candidate in sources if candidate in posterior), None)
        if source is None or "impact" not in posterior[source].dims:
            continue
        logs = xr.apply_ufunc(np.log, posterior[source])
        means = {"impacts": logs.mean("impact")} | {
            stem_of(level): logs.assign_coords({level: ("impact", levels)}).groupby(level).mean("impact")
            for level, levels in groups.items()
        }
        comparable |= {f"{name}_of_{level}": xr.apply_ufunc(np.exp, mean) for level, mean in means.items()}
    return comparable
