"""Regression sites: the Gaussian site of each likelihood by least squares over the posterior.

log L(u) is approximated by the parabola l + g (u - m) - (u - m)' P (u - m) / 2 nearest to it over draws of u
from the current approximation, weighted by likelihood over site (Salimans and Knowles 2013 for the
regression; Minka 2001 for the passes). A Laplace site is made at one value of the hyperparameters: it is
poor in a direction that a trace leaves open, as most do beside a discrepancy, where the likelihood is level
about one value and falls off about another. Of dozens of impacts such errors add up. The parabola serves all
draws.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import softmax

from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.factors.conditional import ConditionalPrior, normals
from bayestissue.inference.factors.laplace import least_curvature
from bayestissue.inference.factors.likelihoods import log_likelihoods
from bayestissue.inference.samplers.psis import effective_size

# Draws of each impact's parameters under every one of the population.
_EACH = 4
# In units of what the posterior leaves open.
_LEAST_PRECISION = 1e-3
# Points at which a trace is so much less likely than at its best are no part of the posterior.
_DEEPEST = 30.0
# A parabola in so many parameters has a number of terms, and wants twice as many points.
_POINTS_A_TERM = 2
_RIDGE = 1e-6


def regression_sites(
    model: TraceModel,
    data: TraceData,
    sites: Sites,
    priors: ConditionalPrior,
    rng: np.random.Generator,
) -> Sites:
    """The parabola nearest to each log likelihood over the posterior.

    Points are drawn by the old sites and weighted by likelihood over site, those of one draw of the
    population among themselves. Along an axis where the parabola would open upwards it is made level,
    but for the curvature that its slope needs (`least_curvature`). Where too few points are effective for a
    trace its old site stays.

    Args:
        model: the model.
        data: the dataset.
        sites: the old ones.
        priors: of some hundred draws of the population.
        rng: for the points.
    """
    u, value, weight = _points(model, data, sites, priors, rng)
    weight = np.where(value > value.max(0) - _DEEPEST, weight, 0.0)
    size = u.shape[-1]
    fitted = effective_size(weight) > _POINTS_A_TERM * (1 + size) * (2 + size) / 2
    made = [np.array(part) for part in sites]
    for whole, part in zip(made, _nearest(u[:, fitted], value[:, fitted], weight[:, fitted]), strict=True):
        whole[fitted] = part
    return Sites(*made)


def _nearest(
    u: Float[np.ndarray, "point impact parameter"],
    value: Float[np.ndarray, "point impact"],
    weight: Float[np.ndarray, "point impact"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Centre, slope, precision and level, as `Sites` have them."""
    value = np.where(weight > 0, value, 0.0)
    total = weight.sum(0)
    mean = np.einsum("pi,pia->ia", weight, u) / total[:, None]
    squares = np.einsum("pi,pia,pib->iab", weight, u - mean, u - mean, optimize=True)
    root = np.linalg.cholesky(squares / total[:, None, None])
    inverse = np.linalg.inv(root)
    level, slope, bend = _parabola(np.einsum("iab,pib->pia", inverse, u - mean), value, weight)
    values, axes = np.linalg.eigh(bend)
    # Without curvature a site that slopes has no bound, and all draws would go there.
    least = np.maximum(least_curvature(np.einsum("iab,ia->ib", axes, slope)), _LEAST_PRECISION)
    bend = np.einsum("iab,ib,icb->iac", axes, np.maximum(values, least), axes)
    precision = np.einsum("iba,ibc,icd->iad", inverse, bend, inverse, optimize=True)
    return mean, np.einsum("iba,ib->ia", inverse, slope), precision, level


def _parabola(
    z: Float[np.ndarray, "point impact parameter"],
    value: Float[np.ndarray, "point impact"],
    weight: Float[np.ndarray, "point impact"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Level, slope and minus the second derivatives of the nearest parabola, for each impact."""
    size = z.shape[-1]
    rows, columns = np.triu_indices(size)
    ones = np.ones((*z.shape[:2], 1))
    terms = np.concatenate([ones, z, z[..., rows] * z[..., columns]], axis=-1)
    weighted = terms * weight[..., None]
    matrix = np.einsum("pia,pib->iab", weighted, terms, optimize=True) + _RIDGE * np.eye(terms.shape[-1])
    found = np.linalg.solve(matrix, np.einsum("pia,pi->ia", weighted, value)[..., None])[..., 0]
    bend = np.zeros((z.shape[1], size, size))
    bend[:, rows, columns] -= found[:, 1 + size :]
    bend[:, columns, rows] -= found[:, 1 + size :]
    return found[:, 0], found[:, 1 : 1 + size], bend


def _points(
    model: TraceModel,
    data: TraceData,
    sites: Sites,
    priors: ConditionalPrior,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, the log likelihood there, and their weights, each [point, impact, ...]."""
    u = normals(sites, priors).at(rng.standard_normal((_EACH, *priors.mean.shape)))
    flat = u.reshape(-1, *u.shape[2:])
    value = log_likelihoods(model, data, flat)
    ratio = (value - sites.log_density(flat)).reshape(u.shape[:3])
    with np.errstate(invalid="ignore"):
        weight = softmax(ratio, axis=0)
    return flat, value, weight.reshape(value.shape)
