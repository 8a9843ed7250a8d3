"""Impacts of springs and phantoms of known stiffness: what they say of the masses in the people's fit."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayestissue.base.errors import InputError, Problem, along_with, refuse
from bayestissue.inference.single.impact_estimates import estimate
from bayestissue.model.hierarchy.reference import HALF_WIDTH, Reference, mass_factor, with_declared
from bayestissue.model.hierarchy.trace_data import Prepared, prepare
from bayestissue.recordings.dataset.impact_table import REFERENCE, of_phantoms, session_column

# No mass is wrong by such a factor: a unit is.
_FAR = 10.0

if TYPE_CHECKING:
    from bayestissue.model.hierarchy.specification import ModelSpecification
    from bayestissue.recordings.dataset import Dataset


def split_phantoms(dataset: Dataset) -> tuple[Dataset, Reference | None]:
    """The dataset of people alone, its masses without errors of their own; what phantoms say of the masses.

    The declared error of mass is then one factor of all masses. Of a dataset without phantoms it is as it
    came.

    Raises:
        InputError: errors of mass or gain are not declared, without which phantoms would be to blame the
            recordings on the stiffness; displacements were recorded, or a force besides; no person was hit.
    """
    known = of_phantoms(dataset.impacts)
    if not known.any():
        return dataset, None
    if problems := _unfit(dataset, people=bool((~known).any())):
        raise InputError(problems)
    phantoms, people = (
        _without_error(part, "relative_mass_sd") for part in (dataset.select(known), dataset.people)
    )
    people = replace(people, impacts=people.impacts.drop(columns=list(REFERENCE)))
    return people, _reference(dataset, phantoms)


def _without_error(dataset: Dataset, sd: str) -> Dataset:
    return dataset.with_settings(uncertainty=dataset.uncertainty.model_copy(update={sd: 0.0}))


def prepare_without_phantoms(
    dataset: Dataset, specification: ModelSpecification, *, source: str
) -> tuple[Dataset, Prepared]:
    """The dataset of `split_phantoms`, ready for a fit, with what its phantoms say of the masses.

    Args:
        dataset: of a study, with phantoms or without.
        specification: as of `prepare`.
        source: the model file's name.

    Raises:
        InputError: as of `split_phantoms` and `prepare`; the model takes the mass for each person's own, of
            which the mass that hit a phantom says nothing.
    """
    persons = []
    if specification.mass_error == "subject" and of_phantoms(dataset.impacts).any():
        persons = [Problem.stated("reference-unfit.person", source, None, "mass_error", "subject")]
    with along_with(persons):
        people, reference = split_phantoms(dataset)
    if persons:
        raise InputError(persons)
    return people, replace(prepare(people, specification, source=source), reference=reference)


def phantom_table(phantoms: Dataset) -> pd.DataFrame:
    """K of each phantom impact by itself with its 90 % interval, and what is known of it, in order."""
    table = estimate(phantoms)
    columns = ["impact", "subject", "K_N_per_m", "K_low_N_per_m", "K_high_N_per_m"]
    return table[columns].join(phantoms.impacts[list(REFERENCE)])


def control_chart(dataset: Dataset) -> pd.DataFrame | None:
    """K of each impact of known stiffness over that stiffness; None without any.

    Returns:
        A row an impact, session by session where the dataset has a column of them, else in the order of the
        table: ``label``, its session and name; ``median``, ``low`` and ``high``, K at the recorded mass over
        the known K with its 90 % interval; ``limit``, the half width within which 90 % of it lie, by what
        is declared of the mass and of the known stiffness.
    """
    known, chain = of_phantoms(dataset.impacts), dataset.uncertainty
    if not known.any() or dataset.quantity == "displacement":
        return None
    phantoms = _without_error(dataset.select(known), "relative_mass_sd")
    table = phantom_table(phantoms)
    stiffness, sd = (table[name].to_numpy(float) for name in REFERENCE)
    ends = {"median": "K_N_per_m", "low": "K_low_N_per_m", "high": "K_high_N_per_m"}
    ratios = {name: table[column].to_numpy(float) / stiffness for name, column in ends.items()}
    limit = HALF_WIDTH * np.hypot(chain.relative_mass_sd, sd / stiffness)
    names = table["impact"].astype(str)
    chart = pd.DataFrame({"label": names, **ratios, "limit": limit})
    if (column := session_column(phantoms.impacts)) is None:
        return chart
    sessions = phantoms.impacts[column].astype(str).reset_index(drop=True)
    # As the sessions follow one another in the table.
    order = np.argsort(sessions.factorize()[0], kind="stable")
    return chart.assign(label=f"{column} " + sessions + ", " + names).iloc[order].reset_index(drop=True)


def _reference(dataset: Dataset, phantoms: Dataset) -> Reference:
    table = phantom_table(phantoms)
    exact = _without_error(phantoms, "relative_gain_sd")
    variance, of_exact = (_variance(one) for one in (table, phantom_table(exact)))
    stands = np.isfinite(table["K_N_per_m"].to_numpy()) & np.isfinite(variance)
    if not stands.any():
        raise InputError.stated("reference-unfit.untold", dataset.table, None, REFERENCE[0], len(table))
    # What the gain adds to an impact's error is no less in the mean of many.
    common = float(np.nanmedian(np.maximum(variance - of_exact, 0.0)[stands]))
    stiffness, sd = (table[name].to_numpy(float)[stands] for name in REFERENCE)
    difference = np.log(stiffness / table["K_N_per_m"].to_numpy()[stands])
    # A stiffness of another unit is refused.
    where = "reference-unfit.far", dataset.table, None, REFERENCE[0]
    log_factors = {known: float(np.median(difference[stiffness == known])) for known in np.unique(stiffness)}
    refuse(
        Problem.stated(*where, known, estimate=known / np.exp(log), factor=np.exp(abs(log)))
        for known, log in log_factors.items()
        if abs(log) > np.log(_FAR)
    )
    kinds = pd.Series(list(zip(stiffness, sd, strict=True))).factorize()[0]
    individual = np.maximum(variance[stands] - common, of_exact[stands] / 4)
    by_phantoms = mass_factor(difference, individual, common, sd / stiffness, kinds)
    return with_declared(by_phantoms, dataset.uncertainty.relative_mass_sd, table)


def _variance(table: pd.DataFrame) -> np.ndarray:
    """Of log K, by the interval's width; no number of what the recording does not tell."""
    low, high = (table[f"K_{end}_N_per_m"].to_numpy(float) for end in ("low", "high"))
    with np.errstate(all="ignore"):
        variance: np.ndarray = np.where(low > 0, (np.log(high / low) / (2 * HALF_WIDTH)) ** 2, np.nan)
    return variance


def _unfit(dataset: Dataset, *, people: bool) -> list[Problem]:
    chain = dataset.uncertainty
    wrong = {
        "displacement": (dataset.quantity == "displacement", dataset.quantity),
        "channel": (bool(dataset.channels), len(dataset.channels)),
        "nobody": (not people, "phantoms alone"),
    }
    return [
        Problem.stated("reference-unfit.undeclared", "dataset.toml", None, f"uncertainty.{name}", 0.0)
        for name in ("relative_mass_sd", "relative_gain_sd")
        if not getattr(chain, name)
    ] + [
        Problem.stated(f"reference-unfit.{key}", dataset.table, None, REFERENCE[0], value)
        for key, (is_so, value) in wrong.items()
        if is_so
    ]
