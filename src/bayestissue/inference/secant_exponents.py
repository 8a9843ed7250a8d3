"""Mass exponents of the force over depth: at one depth that all impacts reach, and at each one's greatest.

Where a spring is not straight, conditions scatter by other amounts at another depth. On a tissue that
stiffens a stiffer condition is pressed less deep: at the greatest depths conditions differ less than at one
depth. The scatter of conditions is what leaves a mass exponent open, so it is found anew for each stiffness.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from bayestissue.hierarchy.derived import group_effect
from bayestissue.hierarchy.design import Design
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.inference.element_draws import COMMON_DEPTH
from bayestissue.inference.secant_population import shifted
from bayestissue.inference.trace_draws import Unfolded

# By what it is called: what of an impact it is the exponent of.
EXPONENTS = {f"mass_exponent_{COMMON_DEPTH}": COMMON_DEPTH, "mass_exponent_K_secant": "K_secant"}
_GRID = np.geomspace(1e-4, 10.0, 500)
_BLOCK = 1000


def mass_exponents_of_secants(
    prepared: Prepared, unfolded: Unfolded, seed: int
) -> dict[str, Float[np.ndarray, "chain draw"]]:
    """Slopes on log mass, all else equal, of log K_common_depth and log K_secant.

    In each draw log(K_common_depth / K) is laid out over log K's formula as `shifted` does it. Then exponent,
    intercept and spread of the conditions (of people or of impacts, where mass varies between these) are
    drawn anew given the conditions' own levels, by the priors of log K: see `exponent_of_levels`.

    Args:
        prepared: the fit.
        unfolded: draws of everything; with a discrepancy K is K_secant already: see `of_secant`.
        seed: of these draws.

    Returns:
        `EXPONENTS`, of all draws or of those that are kept of impacts; nothing where impacts have no
        ``K_common_depth``, or log K no exponent.
    """
    design, impacts, which = prepared.design, unfolded.impacts, slice(None)
    if COMMON_DEPTH not in impacts or design.responses["K"].log_mass is None:
        return {}
    if unfolded.kept is not None:
        which = unfolded.kept
    sites = {name: values[:, which] for name, values in unfolded.sites.items() if name.endswith("_K")}
    rng, found = np.random.default_rng([seed, 31]), {}
    for name, secant in EXPONENTS.items():
        if impacts[secant] is impacts["K"]:
            found[name] = sites["mass_exponent_K"]
            continue
        moved = sites | shifted(design, sites, np.log(impacts[secant] / impacts["K"]))
        levels, log_mass, group = _levels(design, moved, np.log(impacts[secant]))
        prior = prepared.model.prior_of(f"sd_{group}_K").log_prob(_GRID)
        exponent = prepared.model.priors.mass_exponent.K
        found[name] = exponent_of_levels(
            levels, log_mass, (exponent.mean, exponent.sd), np.asarray(prior), rng
        )
    return found


def _levels(
    design: Design, sites: dict[str, np.ndarray], logs: Float[np.ndarray, "chain draw impact"]
) -> tuple[Float[np.ndarray, "chain draw unit"], Float[np.ndarray, " unit"], str]:
    """Log K of the conditions, people or impacts between which mass varies, their log mass, and their name.

    Covariates and the other group's effects are taken off.
    """
    log_mass = design.responses["K"].log_mass
    assert log_mass is not None  # noqa: S101 - else there is no exponent
    for group in ("trial", "subject"):
        codes: Int[np.ndarray, " impact"] = getattr(design, group)
        first = np.unique(codes, return_index=True)[1]
        if group in design.responses["K"].groups and np.array_equal(log_mass, log_mass[first][codes]):
            line = sites["intercept_K"][..., None] + sites["mass_exponent_K"][..., None] * log_mass[first]
            return line + group_effect(design, sites, group, "K"), log_mass[first], group
    part = design.responses["K"]
    beside = logs
    if part.names:
        beside = beside - sites["covariate_effect_K"][..., : len(part.names)] @ part.covariates.T
    for group in part.groups:
        beside = beside - group_effect(design, sites, group, "K")[..., getattr(design, group)]
    return beside, log_mass, "impact"


def exponent_of_levels(
    levels: Float[np.ndarray, "chain draw unit"],
    log_mass: Float[np.ndarray, " unit"],
    exponent: tuple[float, float],
    log_prior_of_sd: Float[np.ndarray, " sd"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "chain draw"]:
    """One draw of b for each of y_j = a + b m_j + e_j, e_j ~ N(0, s^2), with a flat prior of a.

    s first: with k units, the residuals' sum of squares R, the least-squares slope b' and the sum of squares
    S of m about its mean, p(s | y) is in proportion to p(s) s^(2 - k) exp(-R / (2 s^2)) N(b' | mean, sd^2 +
    s^2 / S). Then b given s, which is normal.

    Args:
        levels: y.
        log_mass: m.
        exponent: mean and standard deviation of b's normal prior.
        log_prior_of_sd: log p(s) on the grid of this module.
        rng: of the draws.
    """
    centred = log_mass - log_mass.mean()
    squares, (mean, sd) = float(centred @ centred), exponent
    slope = levels @ centred / squares
    left = levels - levels.mean(-1, keepdims=True) - slope[..., None] * centred
    residual, flat = (left**2).sum(-1).ravel(), slope.ravel()
    spread = np.concatenate(
        [
            _drawn_sd(flat[rows], residual[rows], len(log_mass), squares, exponent, log_prior_of_sd, rng)
            for rows in np.array_split(np.arange(flat.size), -(-flat.size // _BLOCK))
        ]
    )
    precision, own = squares / spread**2, 1 / sd**2
    centre = (precision * flat + own * mean) / (precision + own)
    drawn = centre + rng.standard_normal(flat.size) / np.sqrt(precision + own)
    return drawn.reshape(slope.shape)


def _drawn_sd(
    slope: np.ndarray,
    residual: np.ndarray,
    units: int,
    squares: float,
    exponent: tuple[float, float],
    log_prior: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """A draw of s for each slope and residual sum of squares, by inverting its distribution on a grid."""
    mean, sd = exponent
    variance = sd**2 + _GRID**2 / squares
    # The grid is even in log s, which gives one more power of s.
    log_density = (
        log_prior
        + (3 - units) * np.log(_GRID)
        - residual[:, None] / (2 * _GRID**2)
        - (slope[:, None] - mean) ** 2 / (2 * variance)
        - np.log(variance) / 2
    )
    density = np.exp(log_density - log_density.max(1, keepdims=True))
    below = np.cumsum(density, axis=1)
    place = (below < rng.uniform(size=(len(slope), 1)) * below[:, -1:]).sum(1)
    return _GRID[place]
