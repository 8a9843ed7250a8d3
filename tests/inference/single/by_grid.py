"""The posterior of K and C of one impact, by sums over a grid of all its parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayestissue.inference.factors.sites import log_likelihoods
from bayestissue.model.hierarchy.trace_data import Prepared


def quantiles_by_grid(
    case: Prepared, middle: Sequence[float], reach: Sequence[float], size: int
) -> dict[str, np.ndarray]:
    """5, 50 and 95 % points of K and C.

    Args:
        case: one impact alone, its K and C without a formula.
        middle: of log K, log C and the further parameters: where the grid's middle lies.
        reach: how far it goes to either side, so that nothing is lost beyond.
        size: points along each axis.
    """
    priors = case.model.priors
    own = (priors.intercept.K, priors.intercept.C, priors.noise, priors.atanh_theta1)[: len(middle)]
    axes = [np.linspace(m - r, m + r, size) for m, r in zip(middle, reach, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 1, len(axes))
    log_prior = sum(-(((grid[:, 0, a] - p.mean) / p.sd) ** 2) / 2 for a, p in enumerate(own))
    twice_zeta = np.exp(grid[:, 0, 1] - (grid[:, 0, 0] + np.asarray(case.data.log_mass)) / 2)
    log_prior = log_prior + np.log(1 / (1 + twice_zeta**2) * twice_zeta / (1 + twice_zeta))
    density = (log_likelihoods(case.model, case.data, grid)[:, 0] + log_prior).reshape([size] * len(axes))
    weight = np.exp(density - density.max())
    found = {}
    for place, name in enumerate("KC"):
        mass = weight.sum(axis=tuple({*range(len(axes))} - {place}))
        step = axes[place][1] - axes[place][0]
        inner = np.concatenate([[0.0], np.cumsum(mass) / mass.sum()])
        edges = np.append(axes[place] - step / 2, axes[place][-1] + step / 2)
        found[name] = np.exp(np.interp([0.05, 0.5, 0.95], inner, edges))
    return found
