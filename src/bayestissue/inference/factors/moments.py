"""Better summaries of traces, from the moments of their likelihoods.

Each trace's likelihood is compared with its summary at a few points drawn where the whole data set says
that its parameters are.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from scipy.stats import norm, qmc

from bayestissue.hierarchy.gaussian.conditional import Sites
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.factors.laplace import ConditionalPrior, chosen, least_curvature, times
from bayestissue.inference.factors.likelihoods import log_likelihoods

POINTS = 64


class Points(NamedTuple):
    """Points at which likelihood and summary were compared.

    Attributes:
        u: the points.
        log_ratio: log of likelihood over summary.
    """

    u: Float[np.ndarray, "point impact parameter"]
    log_ratio: Float[np.ndarray, "point impact"]


def standard_points(size: int, number: int = POINTS) -> Float[np.ndarray, "point parameter"]:
    """Normal points that fill the space evenly: Sobol's sequence and its mirror image."""
    uniform = qmc.Sobol(size, seed=20).random(number // 2)
    half = norm.ppf(np.clip(uniform, 1e-9, 1 - 1e-9))
    return np.concatenate([half, -half])


class Normals(NamedTuple):
    """Where the population and the summaries put impacts' parameters: mean + root z, z standard normal."""

    mean: Float[np.ndarray, "*draw impact parameter"]
    root: Float[np.ndarray, "*draw impact parameter parameter"]

    def at(
        self, z: Float[np.ndarray, "*draw impact parameter"]
    ) -> Float[np.ndarray, "*draw impact parameter"]:
        """From standard normals."""
        return self.mean + times(self.root, z)


def normals(summaries: Sites, anchor: ConditionalPrior) -> Normals:
    """N(m + V (g + D (a - m)), V) with V = (P + D)^-1, the anchor being N(a, D^-1), of one or more draws."""
    centre, slope = np.asarray(summaries.centre), np.asarray(summaries.slope)
    whole = np.asarray(summaries.precision) + anchor.precision
    toward = slope + times(anchor.precision, anchor.mean - centre)
    # P + D = L L', and so V = (L^-1)' L^-1.
    root = np.linalg.inv(np.linalg.cholesky(whole)).swapaxes(-1, -2)
    return Normals(centre + times(root, times(root.swapaxes(-1, -2), toward)), root)


def points_of(
    summaries: Sites, anchor: ConditionalPrior, standard: Float[np.ndarray, "point parameter"]
) -> Float[np.ndarray, "point impact parameter"]:
    """The same standard normals of every impact taken there."""
    return normals(summaries, anchor).at(standard[:, None])


def compare(
    model: TraceModel,
    data: TraceData,
    summaries: Sites,
    anchor: ConditionalPrior,
    standard: Float[np.ndarray, "point parameter"],
) -> Points:
    """Compare where the population and the summaries put each impact's parameters."""
    u = points_of(summaries, anchor, standard)
    return Points(u, log_likelihoods(model, data, u) - log_site(summaries, u))


def log_site(
    summaries: Sites, u: Float[np.ndarray, "*point impact parameter"]
) -> Float[np.ndarray, "*point impact"]:
    """`Sites.log_summary` as a numpy array."""
    held = Sites._make(map(np.asarray, summaries))
    return np.asarray(held.log_summary(list(np.moveaxis(u, -1, 0))))


def refine(summaries: Sites, anchor: ConditionalPrior, points: Points, *, bent: bool = False) -> Sites:
    """Sites whose product with the population's expectation has the mean and covariance of the truth.

    One step of expectation propagation (Minka 2001), the moments taken over the compared points. Where a
    moment leaves no positive precision to the trace along some axis, the trace being open on that side, its
    old summary stays; or, if that is to be ``bent``, it gets as little precision there as is believable, and
    only the mean is met. It stays too where the points tell too little.
    """
    number = len(points.u)
    most = points.log_ratio.max(0)
    told = np.isfinite(most)
    weight = np.exp(points.log_ratio - np.where(told, most, 0.0))
    weight = np.where(told, weight, 1.0)
    weight /= weight.sum(0)
    told &= 1 / np.square(weight).sum(0) > number / 4
    mean = np.einsum("pi,pia->ia", weight, points.u)
    away = points.u - mean
    covariance = np.einsum("pi,pia,pib->iab", weight, away, away, optimize=True)
    # The same points give the same error where the moments are known: those of the normal itself.
    plain = points.u - points.u.mean(0)
    exact = np.linalg.inv(np.asarray(summaries.precision) + anchor.precision)
    covariance += exact - np.einsum("pia,pib->iab", plain, plain, optimize=True) / number
    bend = np.linalg.inv(np.where(told[:, None, None], covariance, exact)) - anchor.precision
    values, axes = np.linalg.eigh(bend)
    slope = times(anchor.precision, mean - anchor.mean)
    firm = np.maximum(values, least_curvature(times(axes.swapaxes(-1, -2), slope)))
    precision = (axes * firm[:, None]) @ axes.swapaxes(-1, -2)
    found = Sites(mean, slope, precision, np.zeros(len(mean)))  # type: ignore[arg-type]
    # Equal evidence under this population, old and new: the level follows.
    mean_ratio = np.where(
        told, logsumexp(np.where(told, points.log_ratio, 0.0), axis=0) - np.log(number), 0.0
    )
    level = mean_ratio + log_evidence(summaries, anchor) - log_evidence(found, anchor)
    usable = told & ((values[:, 0] > 0) | bent) & np.isfinite(level)
    made = (mean, slope, precision, level)
    pairs = zip(made, map(np.asarray, summaries), strict=True)
    return Sites(*(jnp.asarray(chosen(usable, *pair)) for pair in pairs))


class Inverse(NamedTuple):
    """Of P + D: its inverse and log determinant."""

    matrix: Float[np.ndarray, "*draw impact parameter parameter"]
    log_determinant: Float[np.ndarray, "*draw impact"]


def inverse_of_whole(summaries: Sites, anchor: ConditionalPrior) -> Inverse:
    """What `log_evidence` needs of the precisions, whatever the anchor's mean."""
    whole = np.asarray(summaries.precision) + anchor.precision
    return Inverse(np.linalg.inv(whole), np.linalg.slogdet(whole)[1])


def log_evidence(
    summaries: Sites, anchor: ConditionalPrior, inverse: Inverse | None = None
) -> Float[np.ndarray, "*draw impact"]:
    """Log of the integral of each summary over the anchor, a normal density, of one or more draws."""
    centre, slope, _, level = map(np.asarray, summaries)
    inverse = inverse or inverse_of_whole(summaries, anchor)
    away = anchor.mean - centre
    pulled = times(anchor.precision, away)
    right = slope + pulled
    gained = (right * times(inverse.matrix, right)).sum(-1) - (away * pulled).sum(-1)
    spread = np.linalg.slogdet(anchor.precision)[1] - inverse.log_determinant
    return level + (gained + spread) / 2
