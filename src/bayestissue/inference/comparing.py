"""Models of the same data side by side: leave-one-out scores and stacking weights."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.errors import Coded
from bayestissue.inference.results.cross_validation import above_limit, high, leave_one_out
from bayestissue.results.tables import columns_of

# Of comparison.csv, whose further column says what data the densities are of.
COLUMNS = [name for name in columns_of("comparison") if name != "data"]
BY_IMPACT = "leave one impact out"
BY_TRIAL = "leave one trial out"
FEW = 30


def by_impact(trees: Mapping[str, xr.DataTree], variable: str) -> pd.DataFrame:
    """Leave-one-impact-out accuracy: `by_importance` for the densities of single impacts."""
    return by_importance(trees, variable, BY_IMPACT)


def by_importance(
    trees: Mapping[str, xr.DataTree], variable: str, scheme: str, elements: str = "impacts"
) -> pd.DataFrame:
    """Leave-one-out accuracy by Pareto-smoothed importance sampling, with stacking weights.

    Vehtari, Gelman and Gabry (2017), doi:10.1007/s11222-016-9696-4; Yao et al. (2018),
    doi:10.1214/17-BA1091.

    Args:
        trees: by model, the groups ``posterior`` and ``log_likelihood``.
        variable: the log densities [chain, draw, element] of what is left out in turn.
        scheme: what the table calls it.
        elements: what they are, in the plural.

    Returns:
        `COLUMNS`, one row a model, the best first. ``warning`` counts the elements whose Pareto k̂ is above
        its threshold (`k_threshold`), and says where people or conditions are too few for a standard error to
        be trusted.
    """
    scores = {name: leave_one_out(tree, variable) for name, tree in trees.items()}
    pointwise = {name: score.elpd_i.to_numpy().ravel() for name, score in scores.items()}
    table = _table(scheme, pointwise)
    weights = _stacking_weights(scores)
    table["p_effective"] = [float(scores[name].p) for name in table["model"]]
    table["weight"] = [weights[name] for name in table["model"]]
    few = "" if scheme == BY_IMPACT else _few(len(next(iter(pointwise.values()))), elements)
    table["warning"] = [
        "; ".join(filter(None, (_high(scores[name], elements), few))) for name in table["model"]
    ]
    return table


def _stacking_weights(scores: Mapping[str, Any]) -> dict[str, float]:
    import arviz_stats as az

    if len(scores) < 2:
        return dict.fromkeys(scores, float("nan"))
    # A trace of many samples has a log density of thousands, whose exponential overflows. The weights are
    # the same when each element's densities are taken relative to the best model's.
    best = np.max([score.elpd_i.to_numpy() for score in scores.values()], axis=0)
    relative = {}
    for name, score in scores.items():
        relative[name] = copy.copy(score)
        relative[name].elpd_i = score.elpd_i - best
    with warnings.catch_warnings():
        # A high Pareto k is reported in the table instead.
        warnings.simplefilter("ignore", UserWarning)
        weights = az.compare(relative, method="stacking", round_to="none")["weight"]
    return {name: float(weights[name]) for name in scores}


def _high(score: Any, elements: str) -> str:
    count = int(high(score).sum())
    return f"{count} of {score.pareto_k.size} {elements} with {above_limit(score)}" if count else ""


def _few(count: int, elements: str) -> str:
    if count >= FEW:
        return ""
    return Coded.stated("few-levels", count=count, elements=elements)


def by_trial(pointwise: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """The same from the log predictive densities of whole trials, each given the other trials."""
    table = _table(BY_TRIAL, pointwise)
    table["warning"] = _few(len(next(iter(pointwise.values()))), "trials")
    return table


def _table(scheme: str, pointwise: Mapping[str, np.ndarray]) -> pd.DataFrame:
    models = sorted(pointwise, key=lambda name: -pointwise[name].sum())
    values = np.stack([pointwise[name] for name in models])
    difference = values - values[0]
    columns = {
        "scheme": scheme,
        "model": models,
        "elpd": values.sum(axis=1),
        "se": _standard_errors(values),
        "elpd_difference": difference.sum(axis=1),
        "se_difference": _standard_errors(difference),
    }
    return pd.DataFrame(columns).reindex(columns=COLUMNS).assign(warning="")


def _standard_errors(values: Float[np.ndarray, "model element"]) -> Float[np.ndarray, " model"]:
    count = values.shape[1]
    # One value tells nothing of how they scatter.
    return np.sqrt(count * values.var(axis=1, ddof=1)) if count > 1 else np.full(len(values), np.nan)
