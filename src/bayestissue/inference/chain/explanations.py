"""Every explanation of each trace: the maxima of its likelihood that dispersed starts lead to."""

from __future__ import annotations

from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from bayestissue.base.result import silent
from bayestissue.inference.execution.chunks import Progress
from bayestissue.inference.execution.kept import all_kept, some_impacts, some_of
from bayestissue.inference.factors.expansions import first_guess, laplace_of_all, rows_of
from bayestissue.inference.factors.sites import weak_prior
from bayestissue.model.hierarchy.gaussian.factor import GaussianFactor
from bayestissue.model.hierarchy.trace_data import Prepared
from bayestissue.model.hierarchy.trace_models import with_normal_errors

# Starts are at the first guess and at so many units of log K and log C from it.
APART = 1.2
# A maximum so many nats below the greatest is none that a posterior visits, and one nearer to another than
# so many of its standard deviations is the same.
LEAST, DISTINCT = 10.0, 4.0
# Of one trace.
MOST = 3


def explanations(prepared: Prepared, first: GaussianFactor, progress: Progress = silent) -> GaussianFactor:
    """Laplace sites of all explanations, [site, impact, ...], those of each impact by falling likelihood.

    Where an impact has fewer than others, its further sites say nothing: their log scale is minus infinity.
    Of many impacts a thousand are tried first: if none of them has another, no other is looked for.

    Args:
        prepared: model and data.
        first: the expansions from the first guess.
        progress: told how many starts are done, and of how many.
    """
    if not all_kept(len(first.centre)):
        rows = some_impacts(len(first.centre))
        if len(explanations(some_of(prepared, rows), rows_of(first, rows), progress).centre) == 1:
            return GaussianFactor(*(np.asarray(leaf)[None] for leaf in first))
    data, guess = with_normal_errors(prepared.data), first_guess(prepared)
    shifts = [np.array(shift) * APART for shift in product((-1.0, 1.0), repeat=2)]
    prior, expanded = weak_prior(guess), [first]
    for number, shift in enumerate(shifts):
        progress(number, len(shifts))
        start = guess.copy()
        start[:, :2] += shift
        expanded.append(laplace_of_all(prepared.model, data, start, prior))
    tried = GaussianFactor(*(np.stack(leaves) for leaves in zip(*expanded, strict=True)))
    return _distinct(tried)


def _distinct(tried: GaussianFactor) -> GaussianFactor:
    """The different ones among the expansions of all starts, the best of each impact first."""
    order = np.argsort(-tried.log_scale, axis=0, kind="stable")
    rows = np.arange(order.shape[1])
    ordered = GaussianFactor(*(leaf[order, rows] for leaf in tried))
    maxima: list[Bool[np.ndarray, " impact"]] = []
    for number in range(len(order)):
        centre, value = ordered.centre[number], ordered.log_scale[number]
        another = np.isfinite(value) & (value > ordered.log_scale[0] - LEAST)
        for earlier, is_one in enumerate(maxima):
            another &= ~(is_one & (_distance(ordered, earlier, centre) < DISTINCT))
        maxima.append(another | (number == 0))
    keep = np.array(maxima)
    rank = np.cumsum(keep, axis=0) - 1
    number = min(MOST, int(keep.sum(0).max()))
    sites = GaussianFactor(*(np.repeat(leaf[:1], number, axis=0).copy() for leaf in ordered))
    sites.log_scale[1:] = -np.inf
    for row in range(len(order)):
        for site in range(1, number):
            here = keep[row] & (rank[row] == site)
            for whole, part in zip(sites, ordered, strict=True):
                whole[site, here] = part[row, here]
    return sites


def _distance(
    sites: GaussianFactor, number: int, u: Float[np.ndarray, "impact parameter"]
) -> Float[np.ndarray, " impact"]:
    """Of ``u`` from one of the sites' centres, in its standard deviations."""
    deviation = u - sites.centre[number]
    squares = np.vecdot(deviation, np.matvec(sites.precision[number], deviation))
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))
