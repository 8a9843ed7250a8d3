"""Finished fits of the same data side by side: leave-one-out scores, stacking weights, answers."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.errors import Coded
from bayestissue.inference.answers.finished import Finished
from bayestissue.inference.answers.predictions import predicted
from bayestissue.inference.quantities.secants import EXPONENTS as OF_SECANTS
from bayestissue.inference.quantities.together import OF_IMPACTS, OF_PEOPLE, comparable_draws
from bayestissue.inference.results.cross_validation import (
    above_limit,
    densities_of,
    high,
    leave_one_out,
    scheme_words,
    schemes,
)
from bayestissue.inference.results.labels import ATTRIBUTES, element_attributes
from bayestissue.inference.results.meanings import REFERENCE_OUTCOMES, element_alone, meaning
from bayestissue.inference.samplers.diagnostics import of_element_alone
from bayestissue.results.tables import columns_of, joined

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
    return Coded(f"{count} {elements} only: the standard errors are rough", "few-levels")


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


def observed_by(likelihood: str) -> str:
    """What a likelihood is a density of, as observed_data names it."""
    return "displacement" if likelihood in ("arma", "a2") else "deceleration"


@dataclass(frozen=True)
class FinishedRun:
    """A finished `fit`.

    Attributes:
        name: what tables call it.
        model: the model as resolved, from ``run.json``.
        tree: the groups ``posterior`` (of single impacts what `comparable_draws` asks
            for), ``log_likelihood``, ``log_likelihood_of_groups``, ``observed_data`` and ``constant_data``.
        finished: the run as questions need it.
    """

    name: str
    model: Mapping[str, Any]
    tree: xr.DataTree
    finished: Finished

    @property
    def quantity(self) -> str:
        """See `observed_by`."""
        return observed_by(self.model["likelihood"])

    @property
    def observed(self) -> xr.DataArray:
        """[impact, sample]: the very numbers that the likelihood is a density of."""
        return self.tree["observed_data"].dataset[self.quantity]

    @property
    def people(self) -> np.ndarray:
        """[impact]: whose each impact is."""
        return self.tree["constant_data"].dataset["impact_subject"].astype(str).to_numpy()

    @cached_property
    def outcomes(self) -> dict[str, xr.DataArray]:
        """`OF_OUTCOMES`, [chain, draw] or [chain, draw, subject]; none without a law or a velocity."""
        run = self.finished
        if run.law is None:
            return {}
        people = run.recorded.levels("subject") if run.recorded.tells_people else []
        conditions = [{}, *({"subject": person} for person in people)]
        values = run.law.reference_outcomes(run.posterior, run.recorded, conditions)
        new = predicted(run, [{}]).draws.isel(row=0) if values else {}
        outcomes = {}
        for name, draws in values.items():
            by_chain = draws[None]
            outcomes[f"{name}_typical_person"] = xr.DataArray(by_chain[..., 0], dims=("chain", "draw"))
            outcomes[f"{name}_new"] = new[name].drop_vars("row")
            if people:
                outcomes[f"{name}_subject"] = xr.DataArray(
                    by_chain[..., 1:], {"subject": people}, ("chain", "draw", "subject")
                )
        return outcomes


# By what it is called: the unit of an outcome of the reference impact.
OF_OUTCOMES = {
    f"{name}_{level}": element_attributes()[name]["unit"]
    for level in ("typical_person", "new", "subject")
    for name in REFERENCE_OUTCOMES
}
UNITS = {name: "N/m" if name.startswith("K") else "N s/m" for name in (*OF_IMPACTS, *OF_PEOPLE)}
UNITS |= OF_OUTCOMES
EXPONENTS = ("mass_exponent_K", *OF_SECANTS, "mass_exponent_C")
_OF_LEVELS = ("K_typical_person", "C_typical_person", "K_new", "C_new", "K_subject", "C_subject")
COMPARED = (*EXPONENTS, *OF_IMPACTS, *OF_PEOPLE, *_OF_LEVELS, *OF_OUTCOMES)
_ELEMENTS = {"impact": "impacts", "subject": "people", "trial": "conditions"}
# Far above rounding, far below any recorder's resolution.
_SAME = 1e-9


def compare_runs(runs: Sequence[FinishedRun]) -> pd.DataFrame:
    """Expected log predictive densities of impacts, people and conditions that a run has not seen.

    By Pareto-smoothed importance sampling, the parameters and effects of what is left out being integrated
    out; see `by_importance`. Densities of different numbers have no common scale:
    runs get differences, standard errors and stacking weights only beside runs whose likelihoods are of the
    same numbers, and ``warning`` says so where some are not.

    Args:
        runs: at least two, of the same dataset, with names that differ.

    Returns:
        ``comparison.csv``: a row per scheme and run; ``data`` names the numbers of the density.
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
    return joined("comparison", parts)


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


def posteriors_by_run(runs: Sequence[FinishedRun]) -> pd.DataFrame:
    """Median and 90 % interval of what every run estimates, whatever its likelihood is a density of.

    Mass exponents, of K also that at a common depth where K depends on depth; the secant stiffness and
    equivalent damping of the recorded impacts, which mean the same for every element; and K and C of a
    typical person, of a new impact on a new person and of every person, at the run's own reference mass;
    outcomes of the reference impact on a typical and on every person, which mean the same for every element.
    ``of`` says what an interval is of: that of these impacts together is narrow however much people differ. A
    run whose model lacks a quantity has no row for it; one with a discrepancy none of K, the element's own.

    Returns:
        ``posteriors.csv``, the rows of one quantity together.
    """
    table = joined("posteriors", [part for run in runs for part in _quantiles(run)])
    order = table.assign(
        _variable=table["variable"].map(COMPARED.index), _run=table["run"].map([r.name for r in runs].index)
    )
    ordered = order.sort_values(["_variable", "label", "_run"], kind="stable").index
    return table.loc[ordered].reset_index(drop=True)


def _quantiles(run: FinishedRun) -> list[pd.DataFrame]:
    posterior = run.tree["posterior"].dataset
    typical = {name: posterior[name] for name in COMPARED if name in posterior}
    if element_alone(posterior):
        # Beside a discrepancy K is the element's own part of the force.
        typical = {name: values for name, values in typical.items() if not of_element_alone(name)}
    people = len(np.unique(run.people))
    tables = []
    for name, array in {**comparable_draws(posterior, run.people), **typical, **run.outcomes}.items():
        by_person = "subject" in array.dims
        ordered = array.transpose("chain", ..., *(["subject"] if by_person else [])).to_numpy()
        flat = ordered.reshape(-1, array.sizes["subject"] if by_person else 1)
        low, median, high = np.percentile(flat, [5, 50, 95], axis=0)
        labels = array["subject"].astype(str).to_numpy().tolist() if by_person else [""]
        unit = UNITS.get(name) or (ATTRIBUTES | element_attributes())[name]["unit"]
        person = meaning(name, people=people).level
        table = pd.DataFrame(
            {"label": labels, "median": median, "eti90_low": low, "eti90_high": high, "variable": name}
        )
        tables.append(table.assign(of=person, unit=unit, run=run.name, draws=len(flat)))
    return tables


def same_questions(tables: Mapping[str, Mapping[str, pd.DataFrame]]) -> pd.DataFrame:
    """What every run answers to the same: its ratios between levels of K and C, and its questions.

    Args:
        tables: by run, those of ``contrasts`` and ``questions`` that it has, and further ones of
            ``questions`` under any name.

    Returns:
        ``answers.csv``, the rows of one question together.
    """
    parts = []
    for run, of_run in tables.items():
        for name, frame in of_run.items():
            if name == "contrasts":
                factors = frame["factor"] + " " + frame["level"] + " over " + frame["against"]
                rows = frame.assign(
                    question=frame["quantity"] + ", " + factors, kind="ratio", value=frame["ratio"]
                )
            else:
                claim = frame["posterior"].notna()
                value = frame["posterior"].where(claim, frame["median"])
                kind = frame["unit"].fillna("").where(~claim, "probability")
                # A choice has an answer for each level.
                level = frame["level"].fillna("")
                question = frame["question"] + level.where(level == "", ": " + level)
                rows = frame.assign(question=question, kind=kind, value=value)[value.notna()]
            parts.append(rows.assign(run=run)[columns_of("answers")])
    table = joined("answers", parts).drop_duplicates(["question", "run"], ignore_index=True)
    order = {question: at for at, question in enumerate(dict.fromkeys(table["question"]))}
    return table.sort_values(
        "question", key=lambda column: column.map(order), kind="stable", ignore_index=True
    )
