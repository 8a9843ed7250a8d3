"""Leave-one-out densities by Pareto-smoothed importance sampling, and the Pareto k of each.

With the densities p(y_i | draw) of what is left out, p(y_i | y_-i) is estimated by their mean under weights
in proportion to 1 / p(y_i | draw), the greatest of them smoothed by a generalised Pareto distribution of
shape k (Vehtari, Gelman and Gabry 2017, doi:10.1007/s11222-016-9696-4).
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import logsumexp

from bayestissue.errors import Coded
from bayestissue.inference.samplers.convergence import effective_size, elements_of
from bayestissue.inference.samplers.psis import k_threshold


def above_limit(score: Any) -> Coded:
    """What is wrong with a Pareto k̂ beyond its threshold."""
    return Coded(f"Pareto k above {k_threshold(score.n_samples):.2g}", "pareto-k")


def leave_one_out(tree: xr.DataTree, variable: str, reff: float | None = None) -> Any:
    """ArviZ's scores: elpd_i and pareto_k of each element, and the effective number of parameters p.

    Args:
        tree: the groups ``posterior`` and ``log_likelihood``.
        variable: the log densities [chain, draw, element] of what is left out in turn.
        reff: the `relative_size` of the draws, if it is at hand.
    """
    import arviz_stats as az

    options = {"var_name": variable, "reff": relative_size(tree) if reff is None else reff, "pointwise": True}
    with warnings.catch_warnings():
        # A high pareto_k stands in the tables.
        warnings.simplefilter("ignore", UserWarning)
        try:
            return az.loo(tree, **options)
        except ValueError:
            # Nearly all draws are one and the same, so that the weights have no tail to be smoothed.
            return az.loo(tree, **options, **_unsmoothed(tree, variable))


def high(score: Any) -> np.ndarray:
    """Of each element whether its Pareto k̂ is beyond what the number of draws lets one trust."""
    return score.pareto_k.to_numpy().ravel() > k_threshold(score.n_samples)


def relative_size(tree: xr.DataTree) -> float:
    """Effective sample size over number of draws, the mean over all quantities of the posterior.

    It sets the length of the tail that is smoothed, 3 (S / r_eff)^1/2 of S draws.
    """
    posterior = tree["posterior"].dataset.drop_dims("kept_draw", errors="ignore")
    draws = np.concatenate([elements_of(array) for array in posterior.data_vars.values()])
    chains, length = draws.shape[1:]
    return float(effective_size(draws).mean() / (chains * length)) if chains > 1 else 1.0


def _unsmoothed(tree: xr.DataTree, variable: str) -> dict[str, xr.DataArray]:
    """Plain importance weights, of which nothing vouches for any: Pareto k̂ is infinite."""
    log_weights = -tree["log_likelihood"].dataset[variable]
    axes = tuple(log_weights.get_axis_num(("chain", "draw")))
    log_weights = log_weights - logsumexp(log_weights.to_numpy(), axis=axes, keepdims=True)
    pareto_k = xr.full_like(log_weights.isel(chain=0, draw=0, drop=True), np.inf)
    return {"log_weights": log_weights, "pareto_k": pareto_k}
