"""How well a fit predicts impacts, people and conditions that it has not seen; and what its priors did."""

from __future__ import annotations

import logging

import pandas as pd
import xarray as xr

from bayestissue.inference.comparing.stacking import PARETO_LIMIT, importance_scores

COLUMNS = ["scheme", "label", "elpd", "pareto_k", "warning"]


def cross_validation(tree: xr.DataTree) -> pd.DataFrame:
    """Expected log predictive density of each impact, subject, trial and other level, given all the others.

    By Pareto-smoothed importance sampling (Vehtari, Gelman and Gabry 2017), what is left out having its own
    parameters and effects integrated out in closed form; ``warning`` where Pareto k is above 0.7.
    """
    rows = []
    for dimension, (_, variable) in schemes(tree).items():
        only = densities_of(tree, dimension)
        labels = only["log_likelihood"].dataset[dimension].to_numpy()
        if len(labels) < 2:
            continue
        score = importance_scores({"fit": only}, variable)["fit"]
        for element, elpd, k in zip(labels, score.elpd, score.pareto_k, strict=True):
            warning = f"Pareto k above {PARETO_LIMIT}" if k > PARETO_LIMIT else ""
            rows.append((scheme_words(dimension), str(element), float(elpd), float(k), warning))
    return pd.DataFrame(rows, columns=COLUMNS)


def schemes(tree: xr.DataTree) -> dict[str, tuple[str, str]]:
    """What can be left out of a fit: by dimension the group and variable of its log densities."""
    of_groups = tree["log_likelihood_of_groups"].dataset
    found = {"impact": ("log_likelihood", "trace")}
    for name in of_groups.data_vars:
        if str(name).startswith("traces_of_"):
            found[str(of_groups[name].dims[-1])] = ("log_likelihood_of_groups", str(name))
    return found


def scheme_words(dimension: str) -> str:
    """What tables call leaving out one of a dimension."""
    return f"leave one {dimension} out"


def densities_of(tree: xr.DataTree, dimension: str) -> xr.DataTree:
    """The posterior with the log densities of one of `schemes` alone."""
    group, variable = schemes(tree)[dimension]
    posterior = tree["posterior"].dataset.drop_dims("kept_draw", errors="ignore")
    return xr.DataTree.from_dict({"posterior": posterior, "log_likelihood": tree[group].dataset[[variable]]})


def prior_sensitivity(tree: xr.DataTree) -> pd.DataFrame:
    """Power-scaling sensitivity of population quantities to priors and data (Kallioinen et al. 2024)."""
    import arviz as az

    together = tree["log_likelihood_of_groups"].dataset
    if "traces" in together:
        # Of many impacts only some have log densities of their own; the data are all of them.
        tree = xr.DataTree.from_dict(
            {
                "posterior": tree["posterior"].dataset.drop_dims("kept_draw"),
                "log_prior": tree["log_prior"].dataset,
                "log_likelihood": together[["traces"]],
            }
        )
    posterior = tree["posterior"].dataset
    names = [name for name, array in posterior.data_vars.items() if array.ndim == 2]
    # The table's own column says what ArviZ would say in the log.
    logging.disable(logging.WARNING)
    try:
        table = az.psense_summary(tree, var_names=names, round_to=4)
    finally:
        logging.disable(logging.NOTSET)
    return table.rename_axis("variable").reset_index()[["variable", "prior", "likelihood", "diagnosis"]]
