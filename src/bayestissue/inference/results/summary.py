"""One line for every number of a posterior."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import xarray as xr

QUANTILES = {"eti50_low": 0.25, "eti50_high": 0.75, "eti90_low": 0.05, "eti90_high": 0.95, "median": 0.5}
COLUMNS = [
    "variable",
    "label",
    "unit",
    "mean",
    "sd",
    "median",
    "eti50_low",
    "eti50_high",
    "eti90_low",
    "eti90_high",
    "ess_bulk",
    "ess_tail",
    "r_hat",
    "mcse_mean",
]


def summarise(posterior: xr.Dataset) -> pd.DataFrame:
    """Moments, equal-tailed 50 % and 90 % intervals and reliability of every element of every variable.

    ``label`` joins the coordinates of the element's dimensions, such as ``7, s03``; the unit is the
    variable's attribute. Of what has some draws only ("kept_draw"), drawn afresh for each of them, no chain
    has to be judged: its sample sizes and R-hat are left open.
    """
    table = _of_chains(posterior.drop_dims("kept_draw", errors="ignore"))
    if "kept_draw" not in posterior.dims:
        return table
    kept = [name for name, array in posterior.data_vars.items() if "kept_draw" in array.dims]
    return pd.concat([table, *(_of_kept(str(name), posterior[name]) for name in kept)], ignore_index=True)


def _of_kept(name: str, array: xr.DataArray) -> pd.DataFrame:
    each = array if len(array.dims) > 2 else array.expand_dims({"": [""]}, axis=2)
    labels = each.dims[2]
    draws = each.transpose("chain", "kept_draw", labels).to_numpy()
    draws = draws.reshape(-1, draws.shape[2])
    sd = draws.std(0, ddof=1, dtype=float)
    # By the usual rule 90 % intervals of a hundred draws would hold 88 %.
    quantiles = np.quantile(draws, list(QUANTILES.values()), axis=0, method="weibull")
    columns = {
        "variable": name,
        "label": each[labels].to_numpy().astype(str),
        "unit": array.attrs.get("unit", ""),
        "mean": draws.mean(0, dtype=float),
        "sd": sd,
        "mcse_mean": sd / np.sqrt(len(draws)),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }
    return pd.DataFrame(columns).reindex(columns=COLUMNS)


def _of_chains(posterior: xr.Dataset) -> pd.DataFrame:
    import arviz as az

    over = ["chain", "draw"]
    # What is 0 in every draw, as Hunt and Crossley's stiffness at contact is, has no R-hat.
    with np.errstate(invalid="ignore"):
        parts = {
            "mean": posterior.mean(over),
            "sd": posterior.std(over, ddof=1),
            "ess_bulk": az.ess(posterior, method="bulk"),
            "ess_tail": az.ess(posterior, method="tail"),
            "r_hat": az.rhat(posterior),
            "mcse_mean": az.mcse(posterior, method="mean"),
        }
    quantiles = posterior.quantile(list(QUANTILES.values()), over)
    parts |= {name: quantiles.sel(quantile=level) for name, level in QUANTILES.items()}
    tables = []
    for name, array in posterior.data_vars.items():
        dimensions = [dimension for dimension in array.dims if dimension not in over]
        labels = [
            ", ".join(map(str, key)) for key in itertools.product(*(array[d].to_numpy() for d in dimensions))
        ]
        columns = {column: np.ravel(part[name].to_numpy()) for column, part in parts.items()}
        tables.append(
            pd.DataFrame({"variable": name, "label": labels, "unit": array.attrs.get("unit", "")} | columns)
        )
    return pd.concat(tables, ignore_index=True)[COLUMNS]
