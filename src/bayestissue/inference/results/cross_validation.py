"""Leave-one-out cross-validation of a fit, and power-scaling sensitivity to its priors and data.

With y_i the data of one impact, or of all impacts of a level of a group, elpd_i = log p(y_i | y_-i) is found
from the draws by Pareto-smoothed importance sampling, their weights in proportion to 1 / p(y_i | draw)
(Vehtari, Gelman and Gabry 2017, doi:10.1007/s11222-016-9696-4).
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float
from scipy.special import logsumexp

from bayestissue.base.errors import Coded
from bayestissue.base.impact_arrays import PerDraw
from bayestissue.base.results.tables import joined
from bayestissue.inference.samplers.sampling import effective_size, elements_of, k_threshold


def above_limit(score: Any) -> Coded:
    """What is wrong with a Pareto k̂ beyond its threshold."""
    return Coded.stated("pareto-k.score", limit=k_threshold(score.n_samples))


def leave_one_out(tree: xr.DataTree, reff: float | None = None) -> Any:
    """ArviZ's scores: elpd_i and pareto_k of each element, and the effective number of parameters p.

    Args:
        tree: the groups ``posterior`` and ``log_likelihood``, whose one variable has the log densities
            [chain, draw, element] of what is left out in turn.
        reff: the `relative_size` of the draws, if it is at hand.
    """
    import arviz_stats as az

    options = {"reff": relative_size(tree) if reff is None else reff, "pointwise": True}
    with warnings.catch_warnings():
        # A high pareto_k stands in the tables.
        warnings.simplefilter("ignore", UserWarning)
        try:
            return az.loo(tree, **options)
        except ValueError:
            # Nearly all draws are one and the same, so that the weights have no tail to be smoothed.
            return az.loo(tree, **options, **_unsmoothed(tree))


def high(score: Any) -> np.ndarray:
    """Of each element whether its Pareto k̂ is beyond what the number of draws lets one trust."""
    return score.pareto_k.to_numpy().ravel() > k_threshold(score.n_samples)


def relative_size(tree: xr.DataTree) -> float:
    """Effective sample size over number of draws, the mean over all quantities of the posterior with one.

    It sets the length of the tail that is smoothed, 3 (S / r_eff)^1/2 of S draws.
    """
    posterior = tree["posterior"].dataset.drop_dims("kept_draw", errors="ignore")
    draws = np.concatenate([elements_of(array) for array in posterior.data_vars.values()])
    chains, length = draws.shape[1:]
    return float(np.nanmean(effective_size(draws)) / (chains * length)) if chains > 1 else 1.0


def _unsmoothed(tree: xr.DataTree) -> dict[str, xr.DataArray]:
    """Plain importance weights, of which nothing vouches for any: Pareto k̂ is infinite."""
    (log_weights,) = (-densities for densities in tree["log_likelihood"].dataset.data_vars.values())
    axes = tuple(log_weights.get_axis_num(("chain", "draw")))
    log_weights = log_weights - logsumexp(log_weights.to_numpy(), axis=axes, keepdims=True)
    pareto_k = xr.full_like(log_weights.isel(chain=0, draw=0, drop=True), np.inf)
    return {"log_weights": log_weights, "pareto_k": pareto_k}


# Powers of prior and likelihood, and the sensitivity above which the posterior depends on either.
_POWERS, _SENSITIVE = (0.99, 1.01), 0.05


def cross_validation(tree: xr.DataTree) -> pd.DataFrame:
    """Expected log predictive density of each impact, subject, trial and other level, given all the others.

    By Pareto-smoothed importance sampling (Vehtari, Gelman and Gabry 2017), what is left out having its own
    parameters and effects integrated out in closed form; ``warning`` where Pareto k is above its threshold.
    """
    tables, reff = [], relative_size(tree)
    for dimension, only in schemes(tree).items():
        labels = only["log_likelihood"].dataset[dimension].to_numpy()
        if len(labels) < 2:
            continue
        score = leave_one_out(only, reff)
        columns = {
            "label": labels.astype(str),
            "elpd": score.elpd_i.to_numpy().ravel(),
            "pareto_k": score.pareto_k.to_numpy().ravel(),
            "warning": np.where(high(score), above_limit(score), ""),
        }
        tables.append(pd.DataFrame(columns).assign(scheme=scheme_words(dimension)))
    return joined("cross_validation", tables)


def schemes(tree: xr.DataTree) -> dict[str, xr.DataTree]:
    """What can be left out of a fit: by dimension the posterior, with its log densities alone."""
    posterior = tree["posterior"].dataset.drop_dims("kept_draw", errors="ignore")
    of_groups = tree["log_likelihood_of_groups"].dataset
    densities = {"impact": tree["log_likelihood"].dataset[["trace"]]}
    densities |= {
        str(of_groups[name].dims[-1]): of_groups[[name]]
        for name in of_groups.data_vars
        if str(name).startswith("traces_of_")
    }
    return {
        dimension: xr.DataTree.from_dict({"posterior": posterior, "log_likelihood": of_one})
        for dimension, of_one in densities.items()
    }


def scheme_words(dimension: str) -> str:
    """What tables call leaving out one of a dimension."""
    return f"leave one {dimension} out"


def prior_sensitivity(tree: xr.DataTree) -> pd.DataFrame:
    """Power-scaling sensitivity of population quantities to priors and data (Kallioinen et al. 2024).

    doi:10.1007/s11222-023-10366-5. Posterior draws are weighted as if the prior, or the likelihood, were
    raised to a power near 1; the sensitivity is the derivative, by the log of the power, of the cumulative
    Jensen-Shannon distance from the weighted draws to the unweighted ones. ``diagnosis`` takes 0.05 for the
    limit of both.

    Args:
        tree: with the groups ``posterior``, ``log_prior`` and ``log_likelihood``, or, where only some impacts
            have log densities of their own, the variable ``traces`` in ``log_likelihood_of_groups``.
    """
    posterior = tree["posterior"].dataset
    scalars = {str(name): v for name, v in posterior.data_vars.items() if set(v.dims) == {"chain", "draw"}}
    draws = np.concatenate([elements_of(array) for array in scalars.values()])
    groups = tree["log_likelihood_of_groups"].dataset if "log_likelihood_of_groups" in tree else {}
    data = groups[["traces"]] if "traces" in groups else tree["log_likelihood"].dataset
    columns = {
        name: _sensitivity(
            draws, np.sum([elements_of(a).sum(0) for a in densities.data_vars.values()], axis=0)
        )
        for name, densities in (("prior", tree["log_prior"].dataset), ("likelihood", data))
    }
    table = pd.DataFrame({"variable": list(scalars), **columns})
    prior, likelihood = table["prior"], table["likelihood"]
    conflict = (prior >= _SENSITIVE) & (likelihood >= _SENSITIVE)
    weak = (prior > _SENSITIVE) & (likelihood < _SENSITIVE)
    words = ["potential prior-data conflict", "potential strong prior / weak likelihood"]
    return table.assign(diagnosis=np.select([conflict, weak], words, "\N{CHECK MARK}")).round(4)


def _sensitivity(
    draws: Float[np.ndarray, "quantity chain draw"], log_density: PerDraw
) -> Float[np.ndarray, " quantity"]:
    """Sensitivity of each quantity to the part of the posterior that has this log density."""
    from arviz_stats.base import array_stats

    weights = [np.exp(array_stats.power_scale_lw(log_density, alpha=a, axis=(-2, -1))) for a in _POWERS]
    lower, upper = (np.broadcast_to(weight / weight.sum(), draws.shape) for weight in weights)
    return np.asarray(array_stats.power_scale_sense(draws, lower, upper, *_POWERS))
