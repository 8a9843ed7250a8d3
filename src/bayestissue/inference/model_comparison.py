"""Models of the same data side by side: leave-one-out scores, stacking weights, posteriors, answers."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.errors import Coded
from bayestissue.base.outcome_table import DECLARED, REFERENCE_OUTCOMES
from bayestissue.base.results.tables import columns_of, joined
from bayestissue.inference.answers.predictions import predicted
from bayestissue.inference.answers.study import Study
from bayestissue.inference.checking.findings import of_element_alone
from bayestissue.inference.quantities.secants import EXPONENTS as OF_SECANTS
from bayestissue.inference.quantities.secants import OF_IMPACTS, OF_PEOPLE, comparable_draws
from bayestissue.inference.results.cross_validation import (
    above_limit,
    high,
    leave_one_out,
    scheme_words,
    schemes,
)
from bayestissue.inference.results.meanings import UNITS, meaning
from bayestissue.inference.samplers.sampling import interval

type Trees = Mapping[str, xr.DataTree]
type Models = Mapping[str, Mapping[str, Any]]

# Of comparison.csv, whose further column says what data the densities are of.
COLUMNS = [name for name in columns_of("comparison") if name != "data"]
BY_IMPACT = "leave one impact out"
BY_TRIAL = "leave one trial out"
FEW = 30


def by_importance(trees: Trees, scheme: str, elements: str = "impacts") -> pd.DataFrame:
    """Leave-one-out accuracy by Pareto-smoothed importance sampling, with stacking weights.

    Vehtari, Gelman and Gabry (2017), doi:10.1007/s11222-016-9696-4; Yao et al. (2018),
    doi:10.1214/17-BA1091.

    Args:
        trees: by model, as of `leave_one_out`.
        scheme: what the table calls it.
        elements: what they are, in the plural.

    Returns:
        `COLUMNS`, one row a model, the best first. ``warning`` counts the elements whose Pareto k̂ is above
        its threshold (`k_threshold`), and says where people or conditions are too few for a standard error to
        be trusted.
    """
    scores = {name: leave_one_out(tree) for name, tree in trees.items()}
    pointwise = {name: score.elpd_i.to_numpy().ravel() for name, score in scores.items()}
    table = _table(scheme, pointwise)
    weights = _stacking_weights(scores)
    table["p_effective"] = [float(scores[name].p) for name in table["model"]]
    table["weight"] = [weights[name] for name in table["model"]]
    few = "" if scheme == BY_IMPACT else _few(len(next(iter(pointwise.values()))), elements)
    for row, name in enumerate(table["model"]):
        above = high(scores[name])
        said = f"{above.sum()} of {above.size} {elements} with {above_limit(scores[name])}"
        table.loc[row, "warning"] = "; ".join(filter(None, (said if above.any() else "", few)))
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


# By what it is called: the unit of an outcome of the reference impact.
OF_OUTCOMES = {
    f"{name}_{level}": DECLARED[name].unit
    for level in ("typical_person", "new", "subject")
    for name in REFERENCE_OUTCOMES
}
_OF_LEVELS = ("K_typical_person", "C_typical_person", "K_new", "C_new", "K_subject", "C_subject")
# All that is compared, by its name, with its unit.
COMPARED = {
    **dict.fromkeys(("mass_exponent_K", *OF_SECANTS, "mass_exponent_C"), "1"),
    **{name: UNITS[name[0]] for name in (*OF_IMPACTS, *OF_PEOPLE, *_OF_LEVELS)},
    **OF_OUTCOMES,
}
_ELEMENTS = {"impact": "impacts", "subject": "people", "trial": "conditions"}
# Far above rounding, far below any recorder's resolution.
_SAME = 1e-9


def compare_runs(trees: Trees, models: Models) -> pd.DataFrame:
    """Expected log predictive densities of impacts, people and conditions that a run has not seen.

    By Pareto-smoothed importance sampling, the parameters and effects of what is left out being integrated
    out; see `by_importance`. Densities of different numbers have no common scale:
    runs get differences, standard errors and stacking weights only beside runs whose likelihoods are of the
    same numbers, and ``warning`` says so where some are not.

    Args:
        trees: of at least two runs of the same dataset, by name, the groups of ``posterior.nc``.
        models: of each as ``run.json`` has it.

    Returns:
        ``comparison.csv``: a row per scheme and run; ``data`` names the numbers of the density.
    """
    groups = of_same_numbers(trees, models)
    names = _data_names([models[group[0]] for group in groups])
    parts, schemes_of = [], {name: schemes(tree) for name, tree in trees.items()}
    for dimension in dict.fromkeys(scheme for of_run in schemes_of.values() for scheme in of_run):
        for data, group in zip(names, groups, strict=True):
            if not all(dimension in schemes_of[name] for name in group):
                continue
            levels = trees[group[0]]["log_likelihood_of_groups"].dataset.get(dimension, (0, 0))
            if len(levels) < 2:
                continue
            densities = {name: schemes_of[name][dimension] for name in group}
            elements = _ELEMENTS.get(dimension, f"levels of {dimension}")
            table = by_importance(densities, scheme_words(dimension), elements).assign(data=data)
            if len(group) == 1:
                table[["elpd_difference", "se_difference", "weight"]] = np.nan
            others = [name for name in trees if name not in group]
            if others:
                apart = Coded.stated("other-numbers", others=", ".join(others))
                table["warning"] = [f"{said}; {apart}" if said else apart for said in table["warning"]]
            parts.append(table)
    return joined("comparison", parts)


def of_same_numbers(trees: Trees, models: Models) -> list[list[str]]:
    """The names of runs, sorted by what their likelihoods are densities of."""
    groups: list[list[str]] = []
    for name, model in models.items():
        quantity = observed_by(model)
        for group in groups:
            if quantity == observed_by(models[group[0]]) and _same_numbers(
                *(trees[one]["observed_data"].dataset[quantity] for one in (group[0], name))
            ):
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def observed_by(model: Mapping[str, Any]) -> str:
    """What the likelihood of a model is a density of, as observed_data names it."""
    return "displacement" if model["likelihood"] in ("arma", "a2") else "deceleration"


def _same_numbers(a: xr.DataArray, b: xr.DataArray) -> bool:
    if a.shape != b.shape or a["impact"].to_numpy().tolist() != b["impact"].to_numpy().tolist():
        return False
    x, y = a.to_numpy(), b.to_numpy()
    return bool(np.allclose(x, y, rtol=0, atol=_SAME * np.nanmax(np.abs(x)), equal_nan=True))


def _data_names(models: Sequence[Mapping[str, Any]]) -> list[str]:
    """The quantity, with the signal options in which models differ where the quantity is not enough."""
    quantities = [observed_by(model) for model in models]
    options = [model.get("signal", {}) for model in models]
    names = []
    for quantity, settings in zip(quantities, options, strict=True):
        rivals = [o for rival, o in zip(quantities, options, strict=True) if rival == quantity]
        differ = [key for key in settings if any(rival.get(key) != settings[key] for rival in rivals)]
        names.append(", ".join([quantity, *(f"{key} {settings[key]}" for key in differ)]))
    return names


def posteriors_by_run(runs: Mapping[str, Study]) -> pd.DataFrame:
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
    table = joined("posteriors", [part for name, run in runs.items() for part in _quantiles(name, run)])
    order = table.assign(
        _variable=table["variable"].map(list(COMPARED).index), _run=table["run"].map(list(runs).index)
    )
    ordered = order.sort_values(["_variable", "label", "_run"], kind="stable").index
    return table.loc[ordered].reset_index(drop=True)


def _quantiles(name_of_run: str, run: Study) -> list[pd.DataFrame]:
    posterior, of_impacts = run.draws, run.recorded.rows["subject"].to_numpy(str)
    typical = {name: posterior[name] for name in COMPARED if name in posterior}
    if run.element_alone:
        # Beside a discrepancy K is the element's own part of the force.
        typical = {name: values for name, values in typical.items() if not of_element_alone(name)}
    people = len(np.unique(of_impacts))
    tables = []
    together = comparable_draws(posterior, {"subject": of_impacts})
    for name, array in {**together, **typical, **_outcomes(run)}.items():
        by_person = array if "subject" in array.dims else array.expand_dims(subject=[""])
        ends, labels = interval(by_person), by_person["subject"].astype(str).to_numpy().tolist()
        person = meaning(name, people=people).level
        table = pd.DataFrame({"label": labels, "median": ends["median"], "variable": name})
        table = table.assign(eti90_low=ends["low"], eti90_high=ends["high"])
        tables.append(
            table.assign(of=person, unit=COMPARED[name], run=name_of_run, draws=array.size // len(labels))
        )
    return tables


def _outcomes(run: Study) -> dict[str, xr.DataArray]:
    """`OF_OUTCOMES`, [chain, draw] or [chain, draw, subject]; none without a law or a velocity."""
    people = run.recorded.levels("subject") if run.recorded.tells_people else []
    values = run.of_reference_impact([{}, *({"subject": person} for person in people)])
    new = predicted(run, [{}]).draws.isel(row=0) if values else {}
    outcomes = {}
    for name, draws in values.items():
        outcomes[f"{name}_typical_person"] = draws.isel(condition=0)
        outcomes[f"{name}_new"] = new[name].drop_vars("row")
        if people:
            of_people = draws.isel(condition=slice(1, None)).rename(condition="subject")
            outcomes[f"{name}_subject"] = of_people.assign_coords(subject=people)
    return outcomes


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
    # As the questions first stand.
    order = np.argsort(table["question"].factorize()[0], kind="stable")
    return table.iloc[order].reset_index(drop=True)
