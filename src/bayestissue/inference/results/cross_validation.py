"""Leave-one-out cross-validation of a fit, and power-scaling sensitivity to its priors and data.

With y_i the data of one impact, or of all impacts of a level of a group, elpd_i = log p(y_i | y_-i) is found
from the draws by Pareto-smoothed importance sampling, their weights in proportion to 1 / p(y_i | draw)
(Vehtari, Gelman and Gabry 2017, doi:10.1007/s11222-016-9696-4).
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.inference.results.leave_one_out import above_limit, high, leave_one_out, relative_size
from bayestissue.inference.samplers.convergence import elements_of

COLUMNS = ["scheme", "label", "elpd", "pareto_k", "warning"]
# Powers of prior and likelihood, and the sensitivity above which the posterior depends on either.
_POWERS, _SENSITIVE = (0.99, 1.01), 0.05


def cross_validation(tree: xr.DataTree) -> pd.DataFrame:
    """Expected log predictive density of each impact, subject, trial and other level, given all the others.

    By Pareto-smoothed importance sampling (Vehtari, Gelman and Gabry 2017), what is left out having its own
    parameters and effects integrated out in closed form; ``warning`` where Pareto k is above its threshold.
    """
    tables, reff = [], relative_size(tree)
    for dimension, (_, variable) in schemes(tree).items():
        only = densities_of(tree, dimension)
        labels = only["log_likelihood"].dataset[dimension].to_numpy()
        if len(labels) < 2:
            continue
        score = leave_one_out(only, variable, reff)
        columns = {
            "label": labels.astype(str),
            "elpd": score.elpd_i.to_numpy().ravel(),
            "pareto_k": score.pareto_k.to_numpy().ravel(),
            "warning": np.where(high(score), above_limit(score), ""),
        }
        tables.append(pd.DataFrame(columns).assign(scheme=scheme_words(dimension))[COLUMNS])
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=COLUMNS)


def schemes(tree: xr.DataTree) -> dict[str, tuple[str, str]]:
    """What can be left out of a fit: by dimension the group and variable of its log densities."""
    of_groups = tree["log_likelihood_of_groups"].dataset
    variables = {"impact": ("log_likelihood", "trace")}
    for name in of_groups.data_vars:
        if str(name).startswith("traces_of_"):
            variables[str(of_groups[name].dims[-1])] = ("log_likelihood_of_groups", str(name))
    return variables


def scheme_words(dimension: str) -> str:
    """What tables call leaving out one of a dimension."""
    return f"leave one {dimension} out"


def densities_of(tree: xr.DataTree, dimension: str) -> xr.DataTree:
    """The posterior with the log densities of one of `schemes` alone."""
    group, variable = schemes(tree)[dimension]
    posterior = tree["posterior"].dataset.drop_dims("kept_draw", errors="ignore")
    return xr.DataTree.from_dict({"posterior": posterior, "log_likelihood": tree[group].dataset[[variable]]})


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
    draws: Float[np.ndarray, "quantity chain draw"], log_density: Float[np.ndarray, "chain draw"]
) -> Float[np.ndarray, " quantity"]:
    """Sensitivity of each quantity to the part of the posterior that has this log density."""
    from arviz_stats.base import array_stats

    weights = [np.exp(array_stats.power_scale_lw(log_density, alpha=a, axis=(-2, -1))) for a in _POWERS]
    lower, upper = (np.broadcast_to(weight / weight.sum(), draws.shape) for weight in weights)
    return np.asarray(array_stats.power_scale_sense(draws, lower, upper, *_POWERS))
