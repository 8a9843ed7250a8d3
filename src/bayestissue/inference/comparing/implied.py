"""Model averaging by stacking: the mixture of several fits' posteriors in proportion to their weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.inference.comparing.finished import FinishedRun
from bayestissue.inference.results.meanings import meaning

# By what it is called: the draws of an impact that it is made of. On a spring and damper side by side the
# secant stiffness is K itself, and C is the equivalent damping.
OF_IMPACTS = {"K_secant_of_impacts": ("K_secant", "K"), "C_equivalent_of_impacts": ("C_equivalent", "C")}
OF_PEOPLE = {"K_secant_of_subject": ("K_secant", "K"), "C_equivalent_of_subject": ("C_equivalent", "C")}
UNITS = {name: "N/m" if name.startswith("K") else "N s/m" for name in (*OF_IMPACTS, *OF_PEOPLE)}
IMPLIED_COLUMNS = [
    "scheme",
    "data",
    "variable",
    "label",
    "of",
    "unit",
    "runs",
    "median",
    "eti90_low",
    "eti90_high",
]
_SCHEMES = ("leave one impact out", "leave one subject out")
# What all runs together that lack a quantity may weigh for it still to be told.
_LEAST_WEIGHT = 0.005


def comparable_draws(posterior: xr.Dataset, people: np.ndarray) -> dict[str, xr.DataArray]:
    """Stiffness and damping that mean the same for every element, of these impacts and of each person's.

    The geometric means over all recorded impacts, and over each person's own, of the secant stiffness and
    of the equivalent damping: for K, exp((1/n) sum_i log K_secant,i), by draw.

    Args:
        posterior: with "K" and "C" [chain, draw or kept draw, impact], and "K_secant" and "C_equivalent"
            where the run's element has them. Nothing comes of a run without single impacts.
        people: [impact], whose each impact is.

    Returns:
        By name, [chain, draw] or [chain, draw, subject].
    """
    comparable = {}
    for name, sources in {**OF_IMPACTS, **OF_PEOPLE}.items():
        source = next((candidate for candidate in sources if candidate in posterior), None)
        if source is None or "impact" not in posterior[source].dims:
            continue
        logs = xr.apply_ufunc(np.log, posterior[source])
        if name in OF_PEOPLE:
            mean = logs.assign_coords(subject=("impact", people)).groupby("subject").mean("impact")
        else:
            mean = logs.mean("impact")
        comparable[name] = xr.apply_ufunc(np.exp, mean)
    return comparable


def implied(runs: Sequence[FinishedRun], comparison: pd.DataFrame) -> pd.DataFrame:
    """Median and 90 % interval of the mixture of the runs' posteriors in proportion to their weights.

    Its density is sum_r w_r p_r, with the stacking weights w_r (Yao et al. 2018, doi:10.1214/17-BA1091) of
    impacts, and of people, left out in turn. K and C of different elements are different things: only what
    means the same in all is mixed.

    Args:
        runs: as `bayestissue.inference.comparing.runs.compare_runs` takes them.
        comparison: what it returned.

    Returns:
        `IMPLIED_COLUMNS`, for each scheme and kind of data in which runs have weights; ``runs`` counts those
        that weigh at least a hundredth.
    """
    draws = {run.name: comparable_draws(run.tree["posterior"].dataset, run.people) for run in runs}
    parts = []
    weighted = comparison[comparison["scheme"].isin(_SCHEMES) & comparison["weight"].notna()]
    for (scheme, data), rows in weighted.groupby(["scheme", "data"], sort=False):
        weights = dict(zip(rows["model"], rows["weight"].clip(lower=0.0), strict=True))
        for name, unit in UNITS.items():
            having = {run: draws[run][name] for run in weights if name in draws[run]}
            lacking = sum(weight for run, weight in weights.items() if run not in having)
            if having and lacking <= _LEAST_WEIGHT:
                parts.append(
                    mixture({run: (weights[run], array) for run, array in having.items()}).assign(
                        scheme=str(scheme),
                        data=str(data),
                        variable=name,
                        of=meaning(name).level,
                        unit=unit,
                        runs=sum(weight >= 0.01 for weight in weights.values()),
                    )
                )
    if not parts:
        return pd.DataFrame(columns=IMPLIED_COLUMNS)
    return pd.concat(parts, ignore_index=True)[IMPLIED_COLUMNS]


def mixture(weighted: Mapping[str, tuple[float, xr.DataArray]]) -> pd.DataFrame:
    """Quantiles of draws taken together, those of each run sharing its weight evenly.

    Args:
        weighted: by run, its weight and its draws [chain, draw] or [chain, draw, subject], the subjects
            those of the first.

    Returns:
        A row per subject, or one with the label "": median and 90 % interval.
    """
    first = next(iter(weighted.values()))[1]
    labels = first["subject"].to_numpy().tolist() if "subject" in first.dims else [""]
    values, shares = [], []
    for weight, array in weighted.values():
        by_person = array.sel(subject=labels) if labels != [""] else array.expand_dims(subject=[""])
        flat = by_person.transpose(..., "subject").to_numpy().reshape(-1, len(labels))
        values.append(flat)
        shares.append(np.full(len(flat), weight / len(flat)))
    together, share = np.concatenate(values), np.concatenate(shares)
    low, median, high = np.quantile(together, [0.05, 0.5, 0.95], axis=0, weights=share, method="inverted_cdf")
    return pd.DataFrame(
        {"label": list(map(str, labels)), "median": median, "eti90_low": low, "eti90_high": high}
    )
