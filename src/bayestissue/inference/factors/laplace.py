"""Laplace sites: each trace's log likelihood to second order about its maximum, for all impacts together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.factors.conditional import ConditionalPrior
from bayestissue.inference.factors.likelihoods import log_likelihoods

ITERATIONS = 60
# By how much an expansion may exceed its value at the centre, along one axis. One of too little curvature, or
# of the wrong sign, gets the curvature with which it exceeds it by the least.
_MOST_GAIN, _LEAST_GAIN = 20.0, 1.0
_LEAST_BEND = 1e-9
# Of a log parameter of which a trace says nothing.
_LEAST_PRECISION = 1e-3
# Steps of the differences: in conditional standard deviations, so that what a step changes is far above
# rounding, which was measured to be 1e-9 at most; in units of a log parameter, so that it is far below where
# third derivatives count.
_STEP, _SHORTEST, _LONGEST = 0.03, 1e-6, 0.003
# A search is over where no step promises so much log likelihood, or only the least steps gain.
_NOTHING_LEFT, _STUCK = 1e-6, 1e6


def laplace_sites(
    model: TraceModel,
    data: TraceData,
    start: Float[np.ndarray, "impact parameter"],
    anchor: ConditionalPrior,
    iterations: int = ITERATIONS,
) -> Sites:
    """Expand each log likelihood to second order where it, times the anchor, is greatest.

    Levenberg-Marquardt steps on every impact by itself, from differences of the likelihood's values: exact
    enough, since a site only whitens.

    Args:
        model: the model.
        data: the dataset.
        start: first guess.
        anchor: prior that keeps an impact whose trace says little where the others are.
        iterations: the most steps tried; with none the expansion is at ``start``.
    """
    start = np.array(start)
    # How sharply a trace tells its parameters is known only once it was expanded.
    nothing = np.zeros((*start.shape, start.shape[1]))
    best = _expansion(model, data, start, _expansion(model, data, start, nothing).curvature)
    most, damping = best.value + anchor.log_density(start), np.full(len(start), 1e-3)
    for _ in range(iterations):
        candidate, promised = _next_after(best, anchor, damping)
        if not ((promised > _NOTHING_LEFT) & (damping < _STUCK)).any():
            break
        tried = _expansion(model, data, candidate, best.curvature)
        value = tried.value + anchor.log_density(candidate)
        better = value > most
        best = _Expansion(*(chosen(better, *pair) for pair in zip(tried, best, strict=True)))
        most = np.where(better, value, most)
        damping = np.where(better, np.maximum(damping / 10, 1e-14), np.minimum(damping * 10, _STUCK))
    values, axes = np.linalg.eigh(best.curvature)
    firm = curvature_floor(values, np.matvec(axes.mT, best.slope))
    precision = (axes * firm[:, None]) @ axes.mT
    return Sites(best.u, best.slope, precision, best.value)


class _Expansion(NamedTuple):
    """A log likelihood to second order at ``u``, the curvature being minus its second derivatives."""

    u: Float[np.ndarray, "impact parameter"]
    value: Float[np.ndarray, " impact"]
    slope: Float[np.ndarray, "impact parameter"]
    curvature: Float[np.ndarray, "impact parameter parameter"]


def _expansion(
    model: TraceModel,
    data: TraceData,
    u: Float[np.ndarray, "impact parameter"],
    curvature: Float[np.ndarray, "impact parameter parameter"],
) -> _Expansion:
    """Central differences, by steps as long as a ``curvature`` found nearby asks for.

    Where a step leads out of all likelihood there is no expansion, and the value is minus infinity.
    """
    size = u.shape[1]
    bend = np.abs(np.diagonal(curvature, axis1=1, axis2=2))
    step = np.clip(_STEP / np.sqrt(np.maximum(bend, 1e-300)), _SHORTEST, _LONGEST)
    first, second = np.triu_indices(size, 1)
    unit = np.eye(size)
    both = unit[first] + unit[second]
    points = np.concatenate([np.zeros((1, size)), unit, -unit, both, -both])
    middle, up, down, forth, back = np.split(
        log_likelihoods(model, data, u + points[:, None] * step),
        np.cumsum([1, size, size, len(both)]),
    )
    own, bent = up + down, np.empty((size, size, len(u)))
    # Out of all likelihood differences are no numbers.
    with np.errstate(invalid="ignore"):
        bent[range(size), range(size)] = own - 2 * middle
        bent[first, second] = (forth + back - own[first] - own[second] + 2 * middle) / 2
        slope = ((up - down) / 2).T / step
    bent[second, first] = bent[first, second]
    found = -bent.transpose(2, 0, 1) / (step[:, :, None] * step[:, None])
    whole = np.isfinite(found).all((1, 2)) & np.isfinite(slope).all(1)
    return _Expansion(
        u,
        np.where(whole, middle[0], -np.inf),
        np.where(whole[:, None], slope, 0.0),
        np.where(whole[:, None, None], found, 0.0),
    )


def _next_after(
    at: _Expansion, anchor: ConditionalPrior, damping: Float[np.ndarray, " impact"]
) -> tuple[Float[np.ndarray, "impact parameter"], Float[np.ndarray, " impact"]]:
    """The next candidate, and what the best step there is promises."""
    slope = at.slope - np.matvec(anchor.precision, at.u - anchor.mean)
    values, axes = np.linalg.eigh(at.curvature + anchor.precision)
    bend = np.abs(values)
    along = np.matvec(axes.mT, slope)
    firm = bend + damping[:, None] * bend.max(1, keepdims=True)
    move = np.matvec(axes, along / firm)
    promised = (along**2 / np.maximum(bend, 1e-300)).sum(1) / 2
    # No step may be longer than a unit of a log parameter.
    longest = np.maximum(np.abs(move).max(1, keepdims=True), 1.0)
    return at.u + move / longest, promised


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


def least_curvature(slope: Float[np.ndarray, "*axis"]) -> Float[np.ndarray, "*axis"]:
    """The least curvature with which a site of this slope is bounded as `curvature_floor` has it."""
    return np.maximum(slope**2 / (2 * _MOST_GAIN), _LEAST_PRECISION)


def weak_prior(start: Float[np.ndarray, "impact parameter"], sd: float = 2.0) -> ConditionalPrior:
    """A weak anchor about the first guess."""
    return ConditionalPrior(np.asarray(start), np.eye(start.shape[1]) / sd**2)
