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

from bayestissue.hierarchy.gaussian.impacts import Sites
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.factors.conditional import (
    ConditionalPrior,
    log_evidence,
    log_site,
    points_of,
    times,
)
from bayestissue.inference.factors.laplace import chosen, least_curvature
from bayestissue.inference.factors.likelihoods import log_likelihoods


class Points(NamedTuple):
    """Points at which likelihood and summary were compared.

    Attributes:
        u: the points.
        log_ratio: log of likelihood over summary.
    """

    u: Float[np.ndarray, "point impact parameter"]
    log_ratio: Float[np.ndarray, "point impact"]


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
    found = Sites(mean, slope, precision, np.zeros(len(mean)))
    # Equal evidence under this population, old and new: the level follows.
    mean_ratio = np.where(
        told, logsumexp(np.where(told, points.log_ratio, 0.0), axis=0) - np.log(number), 0.0
    )
    level = mean_ratio + log_evidence(summaries, anchor) - log_evidence(found, anchor)
    usable = told & ((values[:, 0] > 0) | bent) & np.isfinite(level)
    made = (mean, slope, precision, level)
    pairs = zip(made, map(np.asarray, summaries), strict=True)
    return Sites(*(jnp.asarray(chosen(usable, *pair)) for pair in pairs))
