"""Gaussian sites of traces: log likelihoods to second order, for all impacts together.

A Laplace site is the expansion about the maximum. It is poor in a direction that a trace leaves open, as
most do beside a discrepancy, where the likelihood is level about one value and falls off about another.
The parabola l + g (u - m) - (u - m)' P (u - m) / 2 nearest to log L(u) at points of the posterior serves all
of it (Salimans and Knowles 2013).

Most of a short fit is spent in the compiler, and most of that on the likelihood. Whoever needs no more than
its values asks `log_likelihoods`, so that it is compiled once for all of them; what is done with the values
is arithmetic on whole arrays, which needs no compiler.
"""

from __future__ import annotations

import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.inference.execution.compiling import by_row, padded
from bayestissue.inference.factors.conditional import ConditionalPrior
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.trace_models import TraceData, TraceModel, log_likelihood

ITERATIONS = 60
# Points of one call of the likelihoods.
POINTS = 64
# By how much an expansion may exceed its value at the centre, along one axis. One of too little curvature, or
# of the wrong sign, gets the curvature with which it exceeds it by the least.
_MOST_GAIN, _LEAST_GAIN = 20.0, 1.0
_LEAST_BEND = 1e-9
# Steps of the differences: in conditional standard deviations, so that what a step changes is far above
# rounding, which was measured to be 1e-9 at most; in units of a log parameter, so that it is far below where
# third derivatives count.
_STEP, _SHORTEST, _LONGEST = 0.03, 1e-6, 0.003
# A search is over where no step promises so much log likelihood, or only the least steps gain.
_NOTHING_LEFT, _STUCK = 1e-6, 1e6
# Of a regression site, in units of what the posterior leaves open.
_LEAST_REGRESSED = 1e-3
# Points at which a trace is so much less likely than at its best are no part of the posterior.
DEEPEST = 30.0
_RIDGE = 1e-6


def laplace_sites(
    model: TraceModel,
    data: TraceData,
    start: Float[np.ndarray, "impact parameter"],
    prior: ConditionalPrior,
    iterations: int = ITERATIONS,
) -> GaussianFactor:
    """Expand each log likelihood to second order where it, times the prior, is greatest.

    Levenberg-Marquardt steps on every impact by itself, from differences of the likelihood's values: exact
    enough, since a site only whitens.

    Args:
        model: the model.
        data: the dataset.
        start: first guess.
        prior: keeps an impact whose trace says little where the others are.
        iterations: the most steps tried; with none the expansion is at ``start``.
    """
    start = np.array(start)
    # How sharply a trace tells its parameters is known only once it was expanded.
    nothing = np.zeros((*start.shape, start.shape[1]))
    best = _expansion(model, data, start, _expansion(model, data, start, nothing).precision)
    most, damping = best.log_scale + prior.log_density(start), np.full(len(start), 1e-3)
    for _ in range(iterations):
        candidate, promised = _next_after(best, prior, damping)
        if not ((promised > _NOTHING_LEFT) & (damping < _STUCK)).any():
            break
        tried = _expansion(model, data, candidate, best.precision)
        value = tried.log_scale + prior.log_density(candidate)
        better = value > most
        best = GaussianFactor(*(chosen(better, *pair) for pair in zip(tried, best, strict=True)))
        most = np.where(better, value, most)
        damping = np.where(better, np.maximum(damping / 10, 1e-14), np.minimum(damping * 10, _STUCK))
    values, axes = np.linalg.eigh(best.precision)
    firm = curvature_floor(values, np.matvec(axes.mT, best.shift))
    return best._replace(precision=(axes * firm[:, None]) @ axes.mT)


def _expansion(
    model: TraceModel,
    data: TraceData,
    u: Float[np.ndarray, "impact parameter"],
    curvature: Float[np.ndarray, "impact parameter parameter"],
) -> GaussianFactor:
    """A log likelihood to second order at ``u``, its precision of whatever sign the curvature has.

    By central differences, with steps as long as a ``curvature`` found nearby asks for.

    Where a step leads out of all likelihood there is no expansion, and the value is minus infinity.
    """
    size = u.shape[1]
    bend = np.abs(np.diagonal(curvature, axis1=1, axis2=2))
    step = np.clip(_STEP / np.sqrt(np.maximum(bend, 1e-300)), _SHORTEST, _LONGEST)
    first, second = np.triu_indices(size, 1)
    unit = np.eye(size)
    pairs = unit[first] + unit[second]
    points = np.concatenate([np.zeros((1, size)), unit, -unit, pairs, -pairs])
    middle, up, down, forth, back = np.split(
        log_likelihoods(model, data, u + points[:, None] * step),
        np.cumsum([1, size, size, len(pairs)]),
    )
    along_axes, hessian = up + down, np.empty((size, size, len(u)))
    # Out of all likelihood differences are no numbers.
    with np.errstate(invalid="ignore"):
        hessian[range(size), range(size)] = along_axes - 2 * middle
        hessian[first, second] = (forth + back - along_axes[first] - along_axes[second] + 2 * middle) / 2
        slope = ((up - down) / 2).T / step
    hessian[second, first] = hessian[first, second]
    curvature = -hessian.transpose(2, 0, 1) / (step[:, :, None] * step[:, None])
    whole = np.isfinite(curvature).all((1, 2)) & np.isfinite(slope).all(1)
    return GaussianFactor(
        u,
        np.where(whole[:, None], slope, 0.0),
        np.where(whole[:, None, None], curvature, 0.0),
        np.where(whole, middle[0], -np.inf),
    )


def _next_after(
    at: GaussianFactor, prior: ConditionalPrior, damping: Float[np.ndarray, " impact"]
) -> tuple[Float[np.ndarray, "impact parameter"], Float[np.ndarray, " impact"]]:
    """The next candidate, and what the best step there is promises."""
    slope = at.shift - np.matvec(prior.precision, at.centre - prior.mean)
    values, axes = np.linalg.eigh(at.precision + prior.precision)
    bend = np.abs(values)
    along = np.matvec(axes.mT, slope)
    firm = bend + damping[:, None] * bend.max(1, keepdims=True)
    move = np.matvec(axes, along / firm)
    promised = (along**2 / np.maximum(bend, 1e-300)).sum(1) / 2
    # No step may be longer than a unit of a log parameter.
    longest = np.maximum(np.abs(move).max(1, keepdims=True), 1.0)
    return at.centre + move / longest, promised


def chosen(better: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
    """Of each impact the new, where it is better."""
    return np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)


def curvature_floor(
    bend: Float[np.ndarray, "*axis"], slope: Float[np.ndarray, "*axis"]
) -> Float[np.ndarray, "*axis"]:
    """Curvature floor: minus the second derivative along each axis, by which a site stays bounded.

    A likelihood expanded away from its own maximum may have curvature of the wrong sign. Its site
    exp(slope s - bend s^2 / 2) must all the same be bounded by a few nats, or else the greater the standard
    deviation between impacts, the more likely such traces would be.

    Args:
        bend: as found, of any sign.
        slope: along the axis.
    """
    believed = (bend > 0) & (slope**2 < 2 * _MOST_GAIN * bend)
    return np.maximum(np.where(believed, bend, slope**2 / (2 * _LEAST_GAIN)), _LEAST_BEND)


def weak_prior(start: Float[np.ndarray, "impact parameter"]) -> ConditionalPrior:
    """A weak prior about the first guess, of a standard deviation of 2."""
    return ConditionalPrior(np.asarray(start), np.eye(start.shape[1]) / 4)


def nearest_parabolas(
    u: Float[np.ndarray, "point impact parameter"],
    value: Float[np.ndarray, "point impact"],
    weight: Float[np.ndarray, "point impact"],
) -> GaussianFactor:
    """The parabola nearest to the values at weighted points, about their mean."""
    value = np.where(weight > 0, value, 0.0)
    total = weight.sum(0)
    mean = np.einsum("pi,pia->ia", weight, u) / total[:, None]
    squares = np.einsum("pi,pia,pib->iab", weight, u - mean, u - mean, optimize=True)
    root = np.linalg.cholesky(squares / total[:, None, None])
    inverse = np.linalg.inv(root)
    level, slope, bend = _parabola(np.einsum("iab,pib->pia", inverse, u - mean), value, weight)
    values, axes = np.linalg.eigh(bend)
    # Without curvature a site that slopes has no bound, and all draws would go there: see `curvature_floor`.
    least = np.maximum(np.einsum("iab,ia->ib", axes, slope) ** 2 / (2 * _MOST_GAIN), _LEAST_REGRESSED)
    bend = np.einsum("iab,ib,icb->iac", axes, np.maximum(values, least), axes)
    precision = np.einsum("iba,ibc,icd->iad", inverse, bend, inverse, optimize=True)
    return GaussianFactor(mean, np.einsum("iba,ib->ia", inverse, slope), precision, level)


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
    coefficients = np.linalg.solve(matrix, np.einsum("pia,pi->ia", weighted, value)[..., None])[..., 0]
    bend = np.zeros((z.shape[1], size, size))
    bend[:, rows, columns] -= coefficients[:, 1 + size :]
    bend[:, columns, rows] -= coefficients[:, 1 + size :]
    return coefficients[:, 0], coefficients[:, 1 : 1 + size], bend


def log_likelihoods(
    model: TraceModel, data: TraceData, u: Float[np.ndarray, "point impact parameter"]
) -> Float[np.ndarray, "point impact"]:
    """Log density of each trace at each of its points, the chain's errors integrated out.

    Minus infinity where there is none.
    """
    density = densities_at(model, data, u)
    return np.where(np.isfinite(density), density, -np.inf)


@padded(1)
@by_row(POINTS, constant=2)
def densities_at(
    model: TraceModel, data: TraceData, u: Float[Array, "impact parameter"]
) -> Float[Array, " impact"]:
    """The same, whatever number there is."""
    return log_likelihood(model, data, list(u.T))
