"""From formulas and a table of impacts to design matrices, refusing what can't be identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.errors import InputError, Problem
from bayestissue.hierarchy.specification import Formulas

MASS_TERM = "log(mass_kg)"
GROUPS = ("subject", "trial")
TIED = {"mass": {"mass_kg"}, "energy": {"energy_J"}, "velocity": {"velocity_m_s"}}
LABELS = ("impact", "subject", "trial")


@dataclass(frozen=True)
class ResponseDesign:
    """The covariates of one response, log K or log C.

    ``covariates`` [row, covariate] are zero at the reference row and scaled to unit standard deviation;
    ``scale`` [covariate] is that standard deviation in the covariate's own unit. The log of mass is kept
    apart in ``log_mass`` [row], centred and never scaled, because its coefficient is the mass exponent.
    """

    names: tuple[str, ...]
    covariates: np.ndarray
    scale: np.ndarray
    log_mass: np.ndarray | None
    groups: tuple[str, ...]


@dataclass(frozen=True)
class Design:
    """Both responses over the same rows, with the index of each row's subject and trial."""

    responses: dict[str, ResponseDesign]
    subject: np.ndarray
    trial: np.ndarray
    subjects: tuple[str, ...]
    trials: tuple[str, ...]
    reference_mass_kg: float


def build_design(
    formulas: Formulas, rows: pd.DataFrame, *, reference_mass_kg: float | None, source: str
) -> Design:
    """Evaluate the formulas of log K and log C over ``rows``, one row an impact (or a cell of the design).

    ``rows`` has the columns ``subject``, ``trial``, ``mass_kg`` and any covariate. The reference row, at
    which the intercepts are reported, has the reference mass and each other covariate's mean.

    Raises:
        InputError: a formula that can't be read, names an unknown column or function, or asks for what
            these rows can't identify; ``source`` is named as the file.
    """
    mass = rows["mass_kg"].to_numpy(float)
    reference = float(np.exp(np.log(mass).mean())) if reference_mass_kg is None else reference_mass_kg
    problems: list[Problem] = []
    responses = {}
    for response, formula in (("K", formulas.K), ("C", formulas.C)):
        place = _Place(source, f"formula.{response}", formula)
        try:
            responses[response] = _response(place, rows, reference)
        except InputError as error:
            problems.extend(error.problems)
    if problems:
        raise InputError(problems)
    subject, subjects = pd.factorize(rows["subject"])
    trial, trials = pd.factorize(rows["trial"])
    return Design(
        responses, subject, trial, tuple(map(str, subjects)), tuple(map(str, trials)), float(reference)
    )


@dataclass(frozen=True)
class _Place:
    source: str
    key: str
    formula: str

    def refuse(self, expected: str, remedy: str) -> InputError:
        return InputError(Problem(self.source, expected, remedy, column=self.key, value=self.formula))


def _response(place: _Place, rows: pd.DataFrame, reference_mass: float) -> ResponseDesign:
    terms, groups = _read(place, rows)
    _refuse_tied(place, terms)
    _refuse_unreplicated(place, rows, groups)
    columns, names = _columns(place, rows, reference_mass, groups)
    if MASS_TERM in names and np.ptp(rows["mass_kg"].to_numpy(float)) == 0:
        raise place.refuse(
            "a mass that varies over the impacts", f"Take {MASS_TERM} out: here mass has one value only."
        )
    log_mass = columns[:, names.index(MASS_TERM)] if MASS_TERM in names else None
    keep = [i for i, name in enumerate(names) if name != MASS_TERM]
    scale = columns[:, keep].std(axis=0)
    _refuse_dependent(place, columns, names)
    return ResponseDesign(
        tuple(names[i] for i in keep), columns[:, keep] / scale, scale, log_mass, tuple(groups)
    )


def _read(place: _Place, rows: pd.DataFrame) -> tuple[list[Any], list[str]]:
    import formulae

    try:
        description = formulae.model_description(place.formula)
    except Exception as error:  # formulae raises its own scanner and parser errors, which share no base
        raise place.refuse(
            f'a formula such as "{MASS_TERM} + (1|subject) + (1|trial)"', f"Mend it: {error}."
        ) from error
    usable = [name for name in rows.columns if name != "impact"]
    variables = {name for term in description.terms for name in getattr(term, "var_names", ())} - {""}
    unknown = sorted(variables - set(usable))
    if unknown:
        raise place.refuse(
            f"columns of the data: {', '.join(usable)}", f"Rename or take out {', '.join(unknown)}."
        )
    groups = [term.name for term in description.group_terms]
    wrong = sorted(set(groups) - {f"1|{group}" for group in GROUPS})
    if wrong:
        raise place.refuse("no other group effects than (1|subject) and (1|trial)", f"Take out ({wrong[0]}).")
    as_covariate = {n for t in description.common_terms for n in getattr(t, "var_names", ())} & set(LABELS)
    if as_covariate:
        name = sorted(as_covariate)[0]
        raise place.refuse(f"{name} as a group effect", f"Write (1|{name}).")
    if not any(term.name == "Intercept" for term in description.common_terms):
        raise place.refuse("an intercept, since K at the reference mass is reported", "Take out the 0 or -1.")
    return list(description.common_terms), [name.removeprefix("1|") for name in groups]


def _columns(
    place: _Place, rows: pd.DataFrame, reference_mass: float, groups: Sequence[str]
) -> tuple[np.ndarray, list[str]]:
    import formulae
    from formulae.environment import Environment

    numeric = rows.select_dtypes("number").columns
    at_reference = {name: rows[name].mean() if name in numeric else rows[name].iloc[0] for name in rows}
    reference = pd.DataFrame([at_reference | {"mass_kg": reference_mass}])
    try:
        # Only these functions are within a formula's reach.
        environment = Environment([{"log": np.log, "sqrt": np.sqrt}])
        common = formulae.design_matrices(place.formula, rows, na_action="error", env=environment).common
        at_reference_row = common.evaluate_new_data(reference)
    except Exception as error:  # as above
        raise place.refuse(
            "terms that can be evaluated: columns, +, :, {arithmetic}, log() and sqrt()", f"Mend it: {error}."
        ) from error
    with np.errstate(invalid="ignore"):  # what is not finite is refused below
        columns = common.design_matrix - at_reference_row.design_matrix
    names = [label for term in common.terms.values() for label in term.labels]
    if not np.isfinite(columns).all():
        bad = names[int(np.flatnonzero(~np.isfinite(columns).all(axis=0))[0])]
        raise place.refuse(
            "finite covariates", f"{bad} is not finite for every impact; transform it otherwise."
        )
    keep = [i for i, name in enumerate(names) if name != "Intercept"]
    return columns[:, keep], [names[i] for i in keep]


def _refuse_tied(place: _Place, terms: list[Any]) -> None:
    variables = {name for term in terms for name in getattr(term, "var_names", ())}
    if all(variables & names for names in TIED.values()):
        raise place.refuse(
            "at most two of mass, energy and velocity, which are tied by E = ½MV²",
            "Take out one of mass_kg, energy_J and velocity_m_s.",
        )


def _refuse_unreplicated(place: _Place, rows: pd.DataFrame, groups: Sequence[str]) -> None:
    for group in groups:
        counts = rows[group].value_counts()
        if len(counts) < 2:
            raise place.refuse(f"more than one {group}", f"Take out (1|{group}).")
        if counts.max() < 2:
            raise place.refuse(
                f"several impacts for at least one {group}",
                f"Take out (1|{group}): with one impact each it can't be told from the impact's own scatter.",
            )


def _refuse_dependent(place: _Place, columns: np.ndarray, names: Sequence[str]) -> None:
    centred = columns - columns.mean(axis=0)
    spread = np.linalg.norm(centred, axis=0)
    flat = [name for name, size in zip(names, spread, strict=True) if size == 0]
    if flat:
        raise place.refuse("covariates that vary", f"Take out {flat[0]}: it has one value only.")
    for count in range(2, len(names) + 1):
        part = centred[:, :count] / spread[:count]
        # The relative precision of a table given to three or four digits: below it, a combination
        # of columns is rounding, not information.
        if np.linalg.svd(part, compute_uv=False)[-1] < 1e-3:
            raise place.refuse(
                "covariates that are no combination of each other",
                f"Take out {names[count - 1]}: the terms before it already determine it.",
            )
