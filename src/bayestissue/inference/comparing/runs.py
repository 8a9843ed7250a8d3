"""Model comparison: expected log predictive densities and estimates of finished fits beside each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.errors import Coded
from bayestissue.inference.comparing.finished import FinishedRun
from bayestissue.inference.comparing.implied import UNITS, comparable_draws
from bayestissue.inference.comparing.stacking import COLUMNS as SCORES
from bayestissue.inference.comparing.stacking import by_importance
from bayestissue.inference.quantities.elements import element_attributes
from bayestissue.inference.quantities.secants import EXPONENTS as OF_SECANTS
from bayestissue.inference.results.cross_validation import densities_of, scheme_words, schemes
from bayestissue.inference.results.labels import ATTRIBUTES
from bayestissue.inference.results.meanings import meaning

COMPARISON_COLUMNS = [SCORES[0], "data", *SCORES[1:]]
POSTERIOR_COLUMNS = ["variable", "label", "of", "unit", "run", "median", "eti90_low", "eti90_high"]
EXPONENTS = ("mass_exponent_K", *OF_SECANTS, "mass_exponent_C")
_TYPICAL = {"K_typical_person": "intercept_K", "C_typical_person": "intercept_C"}
COMPARED = (*EXPONENTS, *UNITS, *_TYPICAL, "K_new", "C_new", "K_subject", "C_subject")
_ELEMENTS = {"impact": "impacts", "subject": "people", "trial": "conditions"}
# Far above rounding, far below any recorder's resolution.
_SAME = 1e-9


def compare_runs(runs: Sequence[FinishedRun]) -> pd.DataFrame:
    """Expected log predictive densities of impacts, people and conditions that a run has not seen.

    By Pareto-smoothed importance sampling, the parameters and effects of what is left out being integrated
    out; see `bayestissue.inference.comparing.stacking`. Densities of different numbers have no common scale:
    runs get differences, standard errors and stacking weights only beside runs whose likelihoods are of the
    same numbers, and ``warning`` says so where some are not.

    Args:
        runs: at least two, of the same dataset, with names that differ.

    Returns:
        `COMPARISON_COLUMNS`: a row per scheme and run; ``data`` names the numbers of the density.
    """
    groups = of_same_numbers(runs)
    names = _data_names(groups)
    parts = []
    for dimension in dict.fromkeys(dimension for run in runs for dimension in schemes(run.tree)):
        for data, group in zip(names, groups, strict=True):
            of_all = [schemes(run.tree) for run in group]
            if not all(dimension in of_one for of_one in of_all):
                continue
            trees = {run.name: densities_of(run.tree, dimension) for run in group}
            if len(group[0].tree["log_likelihood_of_groups"].dataset.get(dimension, (0, 0))) < 2:
                continue
            elements = _ELEMENTS.get(dimension, f"levels of {dimension}")
            variable = of_all[0][dimension][1]
            table = by_importance(trees, variable, scheme_words(dimension), elements).assign(data=data)
            if len(group) == 1:
                table[["elpd_difference", "se_difference", "weight"]] = np.nan
            others = [run.name for run in runs if run not in group]
            if others:
                apart = _apart(others)
                table["warning"] = [f"{said}; {apart}" if said else apart for said in table["warning"]]
            parts.append(table)
    if not parts:
        return pd.DataFrame(columns=COMPARISON_COLUMNS)
    return pd.concat(parts, ignore_index=True)[COMPARISON_COLUMNS]


def _apart(others: Sequence[str]) -> Coded:
    words = f"densities of other numbers than those of {', '.join(others)}: not comparable"
    return Coded(words, "other-numbers")


def of_same_numbers(runs: Sequence[FinishedRun]) -> list[list[FinishedRun]]:
    """The runs, sorted by what their likelihoods are densities of."""
    groups: list[list[FinishedRun]] = []
    for run in runs:
        group = next((runs for runs in groups if _same_numbers(runs[0], run)), None)
        if group is None:
            groups.append([run])
        else:
            group.append(run)
    return groups


def _same_numbers(first: FinishedRun, second: FinishedRun) -> bool:
    a, b = first.observed, second.observed
    if first.quantity != second.quantity or a.shape != b.shape:
        return False
    if a["impact"].to_numpy().tolist() != b["impact"].to_numpy().tolist():
        return False
    x, y = a.to_numpy(), b.to_numpy()
    return bool(np.allclose(x, y, rtol=0, atol=_SAME * np.nanmax(np.abs(x)), equal_nan=True))


def _data_names(groups: Sequence[Sequence[FinishedRun]]) -> list[str]:
    """The quantity, with the signal options in which the groups differ where the quantity is not enough."""
    firsts = [group[0] for group in groups]
    options = [run.model.get("signal", {}) for run in firsts]
    names = []
    for run, settings in zip(firsts, options, strict=True):
        rivals = [o for r, o in zip(firsts, options, strict=True) if r.quantity == run.quantity]
        differ = [key for key in settings if any(rival.get(key) != settings[key] for rival in rivals)]
        names.append(", ".join([run.quantity, *(f"{key} {settings[key]}" for key in differ)]))
    return names


def side_by_side(runs: Sequence[FinishedRun]) -> pd.DataFrame:
    """Median and 90 % interval of what every run estimates, whatever its likelihood is a density of.

    Mass exponents, of K also that at a common depth where K depends on depth; the secant stiffness and
    equivalent damping of the recorded impacts, which mean the same for every element; and K and C of a
    typical person, of a new impact on a new person and of every person, at the run's own reference mass.
    ``of`` says what an interval is of: that of these impacts together is narrow however much people differ. A
    run whose model lacks a quantity has no row for it.

    Returns:
        `POSTERIOR_COLUMNS`, the rows of one quantity together.
    """
    table = pd.concat([part for run in runs for part in _quantiles(run)], ignore_index=True)
    order = table.assign(
        _variable=table["variable"].map(COMPARED.index), _run=table["run"].map([r.name for r in runs].index)
    )
    return table.loc[order.sort_values(["_variable", "label", "_run"], kind="stable").index].reset_index(
        drop=True
    )[POSTERIOR_COLUMNS]


def _quantiles(run: FinishedRun) -> list[pd.DataFrame]:
    posterior = run.tree["posterior"].dataset
    # Runs of earlier versions have a typical person's as an intercept.
    typical = {name: xr.ufuncs.exp(posterior[log]) for name, log in _TYPICAL.items() if log in posterior}
    typical |= {name: posterior[name] for name in COMPARED if name in posterior}
    people = len(np.unique(run.people))
    tables = []
    for name, array in {**comparable_draws(posterior, run.people), **typical}.items():
        by_person = "subject" in array.dims
        flat = array.transpose("chain", ..., *(["subject"] if by_person else [])).to_numpy()
        low, median, high = np.percentile(
            flat.reshape(-1, array.sizes["subject"] if by_person else 1), [5, 50, 95], axis=0
        )
        labels = array["subject"].astype(str).to_numpy().tolist() if by_person else [""]
        unit = UNITS.get(name) or (ATTRIBUTES | element_attributes())[name]["unit"]
        person = meaning(name, people=people).level
        table = pd.DataFrame(
            {"label": labels, "median": median, "eti90_low": low, "eti90_high": high, "variable": name}
        )
        tables.append(table.assign(of=person, unit=unit, run=run.name))
    return tables
