"""Which explanation predicts best what it has not seen: by impact, and by whole trial."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

COLUMNS = [
    "scheme",
    "model",
    "elpd",
    "se",
    "elpd_difference",
    "se_difference",
    "p_effective",
    "weight",
    "warning",
]
BY_IMPACT = "leave one impact out"
BY_TRIAL = "leave one trial out"
PARETO_LIMIT = 0.7


def by_impact(trees: Mapping[str, xr.DataTree], variable: str) -> pd.DataFrame:
    """Leave-one-impact-out accuracy by Pareto-smoothed importance sampling, with stacking weights.

    Vehtari, Gelman and Gabry (2017), doi:10.1007/s11222-016-9696-4; Yao et al. (2018),
    doi:10.1214/17-BA1091. ``warning`` counts the impacts whose Pareto k̂ is above 0.7.
    """
    import arviz as az

    scores = _leave_one_out(trees, variable)
    with warnings.catch_warnings():
        # A high Pareto k is reported in the table instead.
        warnings.simplefilter("ignore", UserWarning)
        weights = az.compare(dict(scores), method="stacking", round_to="none")["weight"]
    pointwise = {name: score.elpd_i.to_numpy().ravel() for name, score in scores.items()}
    table = _table(BY_IMPACT, pointwise)
    table["p_effective"] = [float(scores[name].p) for name in table["model"]]
    table["weight"] = [float(weights[name]) for name in table["model"]]
    high = {name: int((score.pareto_k.to_numpy() > PARETO_LIMIT).sum()) for name, score in scores.items()}
    table["warning"] = [
        f"{high[name]} impacts with Pareto k above {PARETO_LIMIT}" if high[name] else ""
        for name in table["model"]
    ]
    return table


@dataclass(frozen=True)
class ImportanceScores:
    """Pointwise expected log predictive densities, and the Pareto k̂ that tells which can be trusted."""

    elpd: np.ndarray
    pareto_k: np.ndarray


def importance_scores(trees: Mapping[str, xr.DataTree], variable: str) -> dict[str, ImportanceScores]:
    """Leave-one-out densities by Pareto-smoothed importance sampling, for each element of ``variable``."""
    return {
        name: ImportanceScores(np.array(score.elpd_i.to_numpy().ravel()), score.pareto_k.to_numpy().ravel())
        for name, score in _leave_one_out(trees, variable).items()
    }


def _leave_one_out(trees: Mapping[str, xr.DataTree], variable: str) -> dict[str, Any]:
    import arviz as az

    with warnings.catch_warnings():
        # Both callers read pareto_k themselves: one reports it, the other refits where it is high.
        warnings.simplefilter("ignore", UserWarning)
        return {name: az.loo(tree, pointwise=True, var_name=variable) for name, tree in trees.items()}


def by_trial(pointwise: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """The same from the log predictive densities of whole trials, each given the other trials."""
    table = _table(BY_TRIAL, pointwise)
    few = len(next(iter(pointwise.values())))
    table["warning"] = f"{few} trials only: the standard errors are rough" if few < 30 else ""
    return table


def _table(scheme: str, pointwise: Mapping[str, np.ndarray]) -> pd.DataFrame:
    totals = {name: float(values.sum()) for name, values in pointwise.items()}
    order = sorted(totals, key=lambda name: -totals[name])
    best = pointwise[order[0]]
    rows = []
    for name in order:
        values = pointwise[name]
        difference = values - best
        rows.append(
            {
                "scheme": scheme,
                "model": name,
                "elpd": totals[name],
                "se": _standard_error(values),
                "elpd_difference": float(difference.sum()),
                "se_difference": _standard_error(difference),
                "p_effective": np.nan,
                "weight": np.nan,
                "warning": "",
            }
        )
    return pd.DataFrame(rows, columns=COLUMNS)


def _standard_error(values: np.ndarray) -> float:
    return float(np.sqrt(len(values) * values.var(ddof=1)))
