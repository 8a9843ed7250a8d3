"""Posterior summary: moments, quantiles and convergence diagnostics of every quantity, a row each.

Also whether the draws can be trusted: each check has a limit, a meaning and a next step; together a verdict.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.errors import Coded
from bayestissue.base.remedies import sentence
from bayestissue.base.results.tables import columns_of
from bayestissue.inference.samplers.sampling import (
    R_HAT_LIMIT,
    convergence,
    elements_of,
    let_pass,
    quantiles,
)

QUANTILES = {"eti50_low": 0.25, "eti50_high": 0.75, "eti90_low": 0.05, "eti90_high": 0.95, "median": 0.5}
# Where an interval is none, a note is added later.
COLUMNS = [name for name in columns_of("summary") if name != "note"]


def summarise(posterior: xr.Dataset) -> pd.DataFrame:
    """Moments, equal-tailed 50 % and 90 % intervals and reliability of every element of every variable.

    ``label`` joins the coordinates of the element's dimensions, such as ``7, s03``; the unit is the
    variable's attribute. R-hat and the effective sample sizes are those of
    `bayestissue.inference.samplers.sampling`; ``mcse_mean``, the Monte Carlo standard error of the mean,
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


ESS_LIMIT = 400
# A note of a summary's row.
UNSETTLED = Coded.stated("r-hat")


def diagnose(
    summary: pd.DataFrame,
    r_hat_limit: float = R_HAT_LIMIT,
    of_impacts: Collection[str] = (),
    unasked: Collection[str] = (),
) -> dict[str, Any]:
    """The verdict on a run, as it is written to ``diagnostics.json``.

    R̂ and bulk and tail effective sample sizes are rank-normalised (Vehtari et al. 2021,
    doi:10.1214/20-BA1221), the worst over every reported quantity.

    Args:
        summary: as `summarise` makes it; what it leaves open is not judged.
        r_hat_limit: what the greatest R-hat is to be below.
        of_impacts: the variables of single impacts, which fail no fit as far as `let_pass` has it: what of
            them is beyond a limit is not judged.
        unasked: those that follow from others and that nobody asked for, which fail none either.

    Returns:
        ``passed``, ``checks``, ``worst`` by statistic, and ``cause``: what the chains lack most of, in words;
        where there are some, what is ``unsettled`` and not judged.
    """
    sizes = summary[["ess_bulk", "ess_tail"]].min(axis=1)
    beyond = (summary["r_hat"] >= r_hat_limit) | (sizes <= ESS_LIMIT)
    single = summary["variable"].isin(list(of_impacts))
    passes = summary["variable"].isin(list(unasked))
    passes[single] |= let_pass(summary.loc[single, "r_hat"].to_numpy(float))
    unsettled = beyond & passes
    not_judged = names_of_rows(summary[unsettled]).tolist()
    summary = summary[~unsettled]
    worst = {column: _worst(summary, column) for column in ("r_hat", "ess_bulk", "ess_tail")}
    checks = [
        _check("r-hat", limit=r_hat_limit, **worst["r_hat"]),
        _check("effective-sample-size.bulk", limit=ESS_LIMIT, **worst["ess_bulk"]),
        _check("effective-sample-size.tail", limit=ESS_LIMIT, **worst["ess_tail"]),
    ]
    passed = all(check["passed"] for check in checks)
    return {
        "passed": passed,
        "checks": checks,
        "worst": worst,
        "cause": "" if passed else _cause(summary, r_hat_limit, of_impacts),
        **({"unsettled": not_judged} if not_judged else {}),
    }


def more_would_help(diagnostics: dict[str, Any], *, thinned: bool, effective: int) -> bool:
    """Whether a check fails that a longer run passes.

    Args:
        diagnostics: of `diagnose`.
        thinned: whether not all draws were kept, to whose number effective sizes are then bound.
        effective: how many effective draws were asked for; of fewer than the verdict wants, no more are made.
    """
    failed = {check["code"] for check in diagnostics["checks"] if not check["passed"]}
    return "r-hat" in failed or (bool(failed) and not thinned and effective >= ESS_LIMIT)


def _check(key: str, value: float, limit: float, **numbers: object) -> dict[str, Any]:
    """One diagnostic of a run, passed where its value is on the side of the limit that its texts name.

    Args:
        key: of the texts: the code of the warning where it fails, and which check it is of several.
        value: of the diagnostic.
        limit: which it is to be below or above.
        **numbers: by their names in the texts.
    """
    texts = ("name", "limit", "meaning", "next_step")
    words = {text: sentence(f"{key}.{text}", limit=limit, **numbers) for text in texts}
    passed = value < limit if words["limit"].startswith("below") else value > limit
    return {"value": value, "passed": bool(passed), **words, "code": key.partition(".")[0]}


def _cause(summary: pd.DataFrame, r_hat_limit: float, of_impacts: Collection[str]) -> str:
    """The quantity whose chains lack most, in a sentence, and what to do about it in another."""
    size = summary[["ess_bulk", "ess_tail"]].to_numpy(float).min(axis=1)
    of_r_hat = (summary["r_hat"].to_numpy(float) - 1) / (r_hat_limit - 1)
    at = int(np.nanargmax(np.fmax(of_r_hat, ESS_LIMIT / size)))
    row = summary.iloc[at]
    return sentence(
        f"r-hat.cause.{'impact' if row['variable'] in of_impacts else 'population'}",
        impact=row["label"],
        variable=names_of_rows(summary).iloc[at],
        r_hat=row["r_hat"],
        effective=size[at],
    )


def _worst(summary: pd.DataFrame, column: str) -> dict[str, Any]:
    """The greatest R-hat, or the least sample size, and the variable that has it."""
    values = summary[column].to_numpy(float)
    at = int(np.nanargmax(values) if column == "r_hat" else np.nanargmin(values))
    return {"variable": names_of_rows(summary).iloc[at], "value": float(values[at])}


def names_of_rows(summary: pd.DataFrame) -> pd.Series:
    """Each row of the summary in words, such as "K of impact_7"."""
    variable, label = summary["variable"].astype(str), summary["label"].astype(str)
    return variable.where(label == "", variable + " of " + label)
