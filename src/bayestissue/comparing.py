"""Finished fits of the same recordings beside each other: scores, posteriors, answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue import runtime
from bayestissue.errors import Coded, InputError, Problem, all_of, refuse
from bayestissue.finished import Fit, read_run
from bayestissue.inference.answers.predictions import predicted
from bayestissue.inference.answers.questions import ask_what_can_be, numbered, require_parsed
from bayestissue.inference.comparing import by_importance
from bayestissue.inference.quantities.secants import EXPONENTS as OF_SECANTS
from bayestissue.inference.quantities.together import OF_IMPACTS, OF_PEOPLE, comparable_draws
from bayestissue.inference.results.cross_validation import densities_of, scheme_words, schemes
from bayestissue.inference.results.labels import ATTRIBUTES, element_attributes
from bayestissue.inference.results.meanings import REFERENCE_OUTCOMES, element_alone, meaning
from bayestissue.inference.samplers.diagnostics import of_element_alone
from bayestissue.outline import Rows, short
from bayestissue.report.comparison import page_of
from bayestissue.report.run_folder import require_groups
from bayestissue.result import Result
from bayestissue.results.tables import columns_of, joined, wrong_in

_AGAIN = "Give folders of finished runs of `bayestissue fit`."
_unfit = partial(Problem, code="runs-to-compare")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """Finished fits of the same recordings beside each other.

    Attributes:
        about: the content of ``run.json``.
        comparison: a row a scheme and run, the best first: ``comparison.csv``.
        posteriors: median and 90 % interval of what every run estimates: ``posteriors.csv``.
        answers: what every run answers to the same: ``answers.csv``.
        asked: the questions.
    """

    command = "compare"
    table_names = ("comparison", "posteriors", "answers")
    about: dict[str, Any]
    comparison: pd.DataFrame
    posteriors: pd.DataFrame
    answers: pd.DataFrame
    asked: tuple[str, ...] = ()

    def _outline(self) -> tuple[str, Rows]:
        best = self.comparison.groupby("scheme", sort=False).first()
        rows = [(str(scheme), f"{row['model']} predicts best") for scheme, row in best.iterrows()]
        names = ", ".join(run["name"] for run in self.about["runs"])
        more = ("more in", ".comparison, .posteriors, .answers, .page(), .report(path)")
        return f"Comparison of {short(names, 200)}", [*rows, more]

    def page(self) -> str:
        """The HTML of the page."""
        return page_of(self.tables, self.about)


def compare(*runs: Fit | str | Path, ask: str | Sequence[str] = ()) -> Comparison:
    """Which finished fit predicts best what it has not seen, and whether the fits agree on K and C.

    Args:
        runs: two or more fits of the same recordings, or folders of runs.
        ask: questions that each run answers, as `Fit.ask` takes them.

    Returns:
        The comparison: ``.comparison`` (a row a scheme and run), ``.posteriors``, ``.answers``, and the
        methods ``.page()`` and ``.report(folder)``.

    Raises:
        InputError: some are no finished fits, or not of the same recordings; or a question can't be read.

    Example:
        >>> compared = bt.compare("runs/impact", "runs/maxwell", ask="peak_force[mass_kg=5, velocity_m_s=2]")
        >>> compared.comparison[["scheme", "model", "elpd_difference", "weight"]]
    """
    start = runtime.Start()
    if len(runs) < 2:
        named = ", ".join(map(str, runs)) or "none"
        raise InputError(_unfit("compare", "at least two folders", _AGAIN, value=named))
    _require_distinct([Path(run) for run in runs if not isinstance(run, Fit)])
    questions = numbered([ask] if isinstance(ask, str) else ask)
    require_parsed(questions)
    fits = dict(zip(_names(read := all_of(_read, runs)), read, strict=True))
    _require_same_data(fits)
    all_of(_require_densities, read)
    compared, posteriors = compare_runs(fits), posteriors_by_run(fits)
    answers = same_questions(
        {
            name: _answers(fit) | {"asked": ask_what_can_be(fit.finished, questions)}
            for name, fit in fits.items()
        }
    )
    first = read[0].about
    record = start.record(
        "compare",
        "comparison",
        dataset=first.get("dataset", ""),
        words=first.get("words", {}),
        input_hash=first["input_hash"],
        runs=[_of_run(name, fit) for name, fit in fits.items()],
    )
    return Comparison(record, compared, posteriors, answers, tuple(question.text for question in questions))


def _of_run(name: str, fit: Fit) -> dict[str, Any]:
    """What ``run.json`` says of a run."""
    stored = (
        {}
        if fit.dataset is not None or fit.folder is None
        else {
            "folder": str(fit.folder),
            "posterior_hash": runtime.content_hash([fit.folder / "posterior.nc"]),
        }
    )
    return {"name": name, **stored, **{k: fit.about.get(k) for k in ("model", "seed", "started", "verdict")}}


def _answers(fit: Fit) -> dict[str, pd.DataFrame]:
    tables = {}
    for name in ("contrasts", "questions"):
        with suppress(KeyError):
            tables[name] = fit.table(name)
    return tables


def _read(run: Fit | str | Path) -> Fit:
    fit = run if isinstance(run, Fit) else read_run(run)
    if lacking := [key for key in ("input_hash", "model") if not fit.about.get(key)]:
        path = _file(fit, "run.json")
        raise InputError(wrong_in(path, "what every fit writes", _AGAIN, column=lacking[0]))
    return fit


def _require_densities(fit: Fit) -> None:
    """Raise an `InputError` of a fit that lacks what is compared."""
    needed = {
        "log_likelihood": ("trace",),
        "log_likelihood_of_groups": ("traces_of_subject", "traces_of_trial"),
        "constant_data": ("impact_subject", "mass_kg", "velocity_m_s"),
        "observed_data": (observed_by(fit),),
    }
    require_groups(fit.posterior, needed, _file(fit, "posterior.nc"), _AGAIN)


def _file(fit: Fit, name: str) -> Path:
    return (fit.folder or Path()) / name


def _require_distinct(runs: Sequence[Path]) -> None:
    first: dict[Path, Path] = {}
    problems = []
    for path in runs:
        earlier = first.setdefault(path.resolve(), path)
        if earlier is not path:
            another = f"another run than {earlier}"
            problems.append(_unfit(str(path), another, "Name each run once.", value="the same run"))
    refuse(problems)


def _require_same_data(fits: Mapping[str, Fit]) -> None:
    first, *others = fits.values()
    hashes = [
        f"{fit.about['input_hash'][:16]}… (dataset “{fit.about.get('dataset')}”)" for fit in fits.values()
    ]
    where = None, "input_hash"
    refuse(
        Problem.stated(
            "other-data", str(_file(fit, "run.json")), *where, words, first=hashes[0], run=first.folder
        )
        for fit, words in zip(others, hashes[1:], strict=True)
        if fit.about["input_hash"] != first.about["input_hash"]
    )


def _names(fits: Sequence[Fit]) -> list[str]:
    """As many of the last parts of each folder as it takes to tell the runs apart; else models by number."""
    stored = [fit.folder for fit in fits if fit.folder is not None and fit.dataset is None]
    if len(stored) < len(fits):
        return [
            f"{number} {fit.about['model'].get('name', '')}".strip() for number, fit in enumerate(fits, 1)
        ]
    paths = [folder.resolve().parts for folder in stored]
    for count in range(1, max(map(len, paths))):
        names = ["/".join(parts[-count:]) for parts in paths]
        if len(set(names)) == len(names):
            return names
    return [str(folder.resolve()) for folder in stored]


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


def compare_runs(runs: Mapping[str, Fit]) -> pd.DataFrame:
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
    parts = []
    for dimension in dict.fromkeys(each for run in runs.values() for each in schemes(run.posterior)):
        for data, group in zip(_data_names(groups), groups, strict=True):
            trees = {name: run.posterior for name, run in group.items()}
            first, *of_others = [schemes(tree) for tree in trees.values()]
            if not all(dimension in of_one for of_one in (first, *of_others)):
                continue
            levels = next(iter(trees.values()))["log_likelihood_of_groups"].dataset.get(dimension, (0, 0))
            if len(levels) < 2:
                continue
            densities = {name: densities_of(tree, dimension) for name, tree in trees.items()}
            elements = _ELEMENTS.get(dimension, f"levels of {dimension}")
            scheme = scheme_words(dimension)
            table = by_importance(densities, first[dimension][1], scheme, elements).assign(data=data)
            if len(group) == 1:
                table[["elpd_difference", "se_difference", "weight"]] = np.nan
            others = [name for name in runs if name not in group]
            if others:
                apart = Coded.stated("other-numbers", others=", ".join(others))
                table["warning"] = [f"{said}; {apart}" if said else apart for said in table["warning"]]
            parts.append(table)
    return joined("comparison", parts)


def of_same_numbers(runs: Mapping[str, Fit]) -> list[dict[str, Fit]]:
    """The runs, sorted by what their likelihoods are densities of."""
    groups: list[dict[str, Fit]] = []
    for name, run in runs.items():
        group = next((group for group in groups if _same_numbers(next(iter(group.values())), run)), None)
        if group is None:
            groups.append(group := {})
        group[name] = run
    return groups


def observed_by(fit: Fit) -> str:
    """What the likelihood is a density of, as observed_data names it."""
    return "displacement" if fit.about["model"]["likelihood"] in ("arma", "a2") else "deceleration"


def _same_numbers(first: Fit, second: Fit) -> bool:
    quantity = observed_by(first)
    if quantity != observed_by(second):
        return False
    a, b = (fit.posterior["observed_data"].dataset[quantity] for fit in (first, second))
    if a.shape != b.shape or a["impact"].to_numpy().tolist() != b["impact"].to_numpy().tolist():
        return False
    x, y = a.to_numpy(), b.to_numpy()
    return bool(np.allclose(x, y, rtol=0, atol=_SAME * np.nanmax(np.abs(x)), equal_nan=True))


def _data_names(groups: Sequence[Mapping[str, Fit]]) -> list[str]:
    """The quantity, with the signal options in which the groups differ where the quantity is not enough."""
    firsts = [next(iter(group.values())) for group in groups]
    quantities = [observed_by(run) for run in firsts]
    options = [run.about["model"].get("signal", {}) for run in firsts]
    names = []
    for quantity, settings in zip(quantities, options, strict=True):
        rivals = [o for other, o in zip(quantities, options, strict=True) if other == quantity]
        differ = [key for key in settings if any(rival.get(key) != settings[key] for rival in rivals)]
        names.append(", ".join([quantity, *(f"{key} {settings[key]}" for key in differ)]))
    return names


def posteriors_by_run(runs: Mapping[str, Fit]) -> pd.DataFrame:
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
        _variable=table["variable"].map(COMPARED.index), _run=table["run"].map(list(runs).index)
    )
    ordered = order.sort_values(["_variable", "label", "_run"], kind="stable").index
    return table.loc[ordered].reset_index(drop=True)


def _quantiles(run: str, fit: Fit) -> list[pd.DataFrame]:
    posterior = fit.posterior["posterior"].dataset
    of_impacts = fit.posterior["constant_data"].dataset["impact_subject"].astype(str).to_numpy()
    typical = {name: posterior[name] for name in COMPARED if name in posterior}
    if element_alone(posterior):
        # Beside a discrepancy K is the element's own part of the force.
        typical = {name: values for name, values in typical.items() if not of_element_alone(name)}
    people = len(np.unique(of_impacts))
    tables = []
    for name, array in {**comparable_draws(posterior, of_impacts), **typical, **_outcomes(fit)}.items():
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
        tables.append(table.assign(of=person, unit=unit, run=run, draws=len(flat)))
    return tables


def _outcomes(fit: Fit) -> dict[str, xr.DataArray]:
    """`OF_OUTCOMES`, [chain, draw] or [chain, draw, subject]; none without a law or a velocity."""
    run = fit.finished
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
