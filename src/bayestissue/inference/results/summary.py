"""Posterior summary: moments, quantiles and convergence diagnostics of every quantity, a row each."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.results.tables import columns_of
from bayestissue.inference.samplers.convergence import convergence, elements_of
from bayestissue.inference.samplers.sampling import quantiles

QUANTILES = {"eti50_low": 0.25, "eti50_high": 0.75, "eti90_low": 0.05, "eti90_high": 0.95, "median": 0.5}
# Where an interval is none, a note is added later.
COLUMNS = [name for name in columns_of("summary") if name != "note"]


def summarise(posterior: xr.Dataset) -> pd.DataFrame:
    """Moments, equal-tailed 50 % and 90 % intervals and reliability of every element of every variable.

    ``label`` joins the coordinates of the element's dimensions, such as ``7, s03``; the unit is the
    variable's attribute. R-hat and the effective sample sizes are those of
    `bayestissue.inference.samplers.convergence`; ``mcse_mean``, the Monte Carlo standard error of the mean,
    is sd / ess^1/2 with the mean's effective sample size. ``never`` is the share of infinite draws, in which
    what the quantity is the time of never happens; mean and sd are then open. Of what has some draws only
    ("kept_draw"), drawn afresh for each of them, no chain has to be judged: its sample sizes and R-hat are
    left open.
    """
    of_all = posterior.drop_dims("kept_draw", errors="ignore")
    thinned = [name for name in posterior.data_vars if name not in of_all]
    tables = [_of_variable(str(name), posterior[name]) for name in (*of_all.data_vars, *thinned)]
    return pd.concat(tables, ignore_index=True)


def _of_variable(name: str, array: xr.DataArray) -> pd.DataFrame:
    thinned = "kept_draw" in array.dims
    array = array.rename(kept_draw="draw") if thinned else array
    draws = elements_of(array)
    flat = draws.reshape(len(draws), -1)
    # Open where a draw is infinite.
    known = np.where(np.isinf(flat), np.nan, flat)
    mean, sd = known.mean(axis=1), known.std(axis=1, ddof=1)
    # By the usual rule 90 % intervals of a hundred draws would hold 88 %.
    ends = quantiles(flat, list(QUANTILES.values()), "weibull" if thinned else "linear")
    columns = {
        "variable": name,
        "label": _labels(array),
        "unit": array.attrs.get("unit", ""),
        "mean": mean,
        "sd": sd,
        "mcse_mean": sd / np.sqrt(flat.shape[1]),
        "never": np.isinf(flat).mean(axis=1),
        **dict(zip(QUANTILES, ends, strict=True)),
    }
    if not thinned:
        sampled = convergence(draws)
        columns |= sampled._asdict() | {"mcse_mean": sd / np.sqrt(sampled.ess_mean)}
    return pd.DataFrame(columns).reindex(columns=COLUMNS)


def _labels(array: xr.DataArray) -> list[str]:
    """Of each element of a variable, in the order of `elements_of`."""
    coordinates = (array[name].to_numpy() for name in array.dims if name not in ("chain", "draw"))
    return [", ".join(map(str, key)) for key in itertools.product(*coordinates)]


_BINS = 20


def prior_overlap(posterior: Float[np.ndarray, "*draw"], prior: Float[np.ndarray, "*prior_draw"]) -> float:
    """The overlap by draws of both, in bins that have equal shares of the posterior.

    Bins see it a little too large; the scatter of n prior draws in b bins, by about (b / n)^1/2 / 4, too
    small. Infinite draws count as greatest. NaN where the posterior is one number.
    """
    ends = np.quantile(posterior, np.linspace(0, 1, _BINS + 1)[1:-1], method="higher")
    if ends[0] == ends[-1]:
        return np.nan
    shares = (
        np.bincount(np.searchsorted(ends, np.ravel(draws)), minlength=_BINS) / np.size(draws)
        for draws in (posterior, prior)
    )
    return float(np.minimum(*shares).sum())
