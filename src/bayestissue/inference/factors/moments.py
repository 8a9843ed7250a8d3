"""Better summaries of traces, from the moments of their likelihoods.

Each trace's likelihood is compared with its summary at a few points drawn where the whole data set says
that its parameters are.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp
from scipy.stats import norm, qmc

from bayestissue.hierarchy.gaussian.impacts import (
    ImpactConditional,
    ImpactPrior,
    Sites,
    parameters_first,
)
from bayestissue.hierarchy.traces import TraceData, TraceModel
from bayestissue.inference.factors.laplace import ConditionalPrior, chosen, least_curvature, times
from bayestissue.inference.factors.likelihoods import log_likelihoods

POINTS = 64


def evenly_spaced(count: int, number: int = POINTS) -> Int[np.ndarray, " number"]:
    """Places of so many draws among ``count`` of them."""
    return np.linspace(0, count - 1, number).astype(int)


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
    """Where the population and the sites put impacts' parameters, of one or more draws of the population.

    Attributes:
        given: the conditional of `bayestissue.hierarchy.gaussian.impacts`.
        about: X b, the parameters first.
    """

    given: ImpactConditional
    about: Float[np.ndarray, "parameter *draw impact"]

    def at(
        self, z: Float[np.ndarray, "*draw impact parameter"]
    ) -> Float[np.ndarray, "*draw impact parameter"]:
        """From standard normals."""
        return np.stack(self.given.draw(self.about, np.moveaxis(z, -1, 0)), axis=-1)


def normals(summaries: Sites, anchor: ConditionalPrior) -> Normals:
    """See `Normals`; of the sites and a conditional prior N(a, D^-1) of one or more draws."""
    return Normals(conditional_of(summaries, anchor), np.moveaxis(anchor.mean, -1, 0))


def conditional_of(summaries: Sites, anchor: ConditionalPrior) -> ImpactConditional:
    """The conditional of impacts' parameters under the precision of one or more draws of the population."""
    prior = ImpactPrior(
        np.moveaxis(anchor.precision, (-2, -1), (0, 1)),
        np.linalg.slogdet(anchor.precision)[1],
    )
    return ImpactConditional.of(prior, parameters_first(Sites(*map(np.asarray, summaries))))


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
    """`Sites.log_density` as a numpy array."""
    held = Sites._make(map(np.asarray, summaries))
    return np.asarray(held.log_density(u))


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


def log_evidence(summaries: Sites, anchor: ConditionalPrior) -> Float[np.ndarray, "*draw impact"]:
    """Log of the integral of each site over a conditional prior, of one or more draws of the population."""
    given, about = normals(summaries, anchor)
    return given.log_density(about)
