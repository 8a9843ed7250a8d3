"""From formulas and a table of impacts to design matrices, refusing what can't be identified."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.base.errors import InputError, Problem
from bayestissue.model.hierarchy.columns import few_valued
from bayestissue.model.hierarchy.formulas.formula import ResolvedFormula, adapted, resolve
from bayestissue.model.hierarchy.formulas.group_terms import (
    MASS_TERM,
    SUBJECT,
    TRIAL,
    Grouping,
    GroupTerm,
    grouping_of,
)
from bayestissue.model.hierarchy.formulas.identifiability import Fault
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.responses import intercept, parameter_of
from bayestissue.model.hierarchy.specification import Formulas


@dataclass(frozen=True)
class GroupColumn:
    """The covariate whose coefficient differs between the levels of a group term's grouping.

    ``covariate`` [row] is 1 for an intercept. Any other is zero at the reference row and scaled to unit
    standard deviation, ``scale`` being that in the covariate's own unit; the log of mass is not scaled.
    """

    covariate: np.ndarray
    scale: float = 1.0


@dataclass(frozen=True)
class ResponseDesign:
    """The covariates of one response: log K, log C, or the log of an element's further parameter.

    ``covariates`` [row, covariate] are zero at the reference row and scaled to unit standard deviation;
    ``scale`` [covariate] is that standard deviation in the covariate's own unit. The log of mass is kept
    apart in ``log_mass`` [row], centred and never scaled, because its coefficient is the mass exponent.
    ``terms`` has the group terms and what their effects multiply. ``parameter`` of an impact is what all this
    is of: "K", "C", or "log_thickness_m" where the ``response`` is thickness_m.
    """

    parameter: str
    names: tuple[str, ...]
    covariates: np.ndarray
    scale: np.ndarray
    log_mass: np.ndarray | None
    terms: Mapping[GroupTerm, GroupColumn]

    @property
    def response(self) -> str:
        """What formulas call the parameter, and names of effects end with."""
        return self.parameter.removeprefix("log_")

    @property
    def fixed(self) -> dict[str, np.ndarray]:
        """The columns of its fixed effects, [row, column], by what these are called."""
        columns = {intercept(self.parameter): np.ones((len(self.covariates), 1))}
        if self.log_mass is not None:
            columns[f"mass_exponent_{self.response}"] = self.log_mass[:, None]
        if self.names:
            columns[f"covariate_effect_{self.response}"] = self.covariates
        return columns

    @property
    def groups(self) -> tuple[str, ...]:
        """The groupings whose levels have an intercept of their own."""
        return tuple(term.grouping for term in self.terms if not term.slope)


@dataclass(frozen=True)
class Design:
    """All responses over the same rows, with each row's level of every grouping.

    ``responses`` are K, C and those further parameters of an element that have a formula of their own.
    ``groupings`` by name, such as ``subject:side``: subject and trial, whether a formula has them or not, and
    then the others of all formulas. ``formulas`` are the right-hand sides that were evaluated, ``left_out``
    of each response what a formula that nobody wrote would have had besides, and why the rows can't tell it.
    ``recorded`` is what all responses at given levels are told from.
    """

    responses: dict[str, ResponseDesign]
    groupings: Mapping[str, Grouping]
    reference_mass_kg: float
    formulas: Formulas = field(default_factory=Formulas)
    left_out: Mapping[str, tuple[Fault, ...]] = field(default_factory=dict)
    recorded: Recorded = field(kw_only=True)

    @property
    def subject(self) -> np.ndarray:
        """The number of each row's subject."""
        return self.groupings["subject"].code

    @property
    def trial(self) -> np.ndarray:
        """The number of each row's trial."""
        return self.groupings["trial"].code

    @property
    def subjects(self) -> tuple[str, ...]:
        """The subjects' labels."""
        return self.groupings["subject"].levels

    @property
    def trials(self) -> tuple[str, ...]:
        """The trials' labels."""
        return self.groupings["trial"].levels

    @property
    def terms(self) -> tuple[GroupTerm, ...]:
        """The group terms of all responses, each once."""
        return tuple(dict.fromkeys(term for part in self.responses.values() for term in part.terms))

    def levels(self) -> dict[str, list[str]]:
        """The names of the levels of every grouping and category, by dimension."""
        formulas = self.recorded.responses.values()
        categories = dict.fromkeys(name for formula in formulas for name in formula.named_by)
        return {name: list(grouping.levels) for name, grouping in self.groupings.items()} | {
            name: self.recorded.levels(name) for name in categories
        }

    def few_valued(self) -> dict[str, list[str]]:
        """The columns of few whole numbers that a formula has as straight lines, and their values."""
        lines = {name for part in self.responses.values() for name in part.names}
        return {name: values for name, values in few_valued(self.recorded.rows).items() if name in lines}

    def resolved(self) -> dict[str, Any]:
        """What ``run.json`` says of the model beside its file: the formulas and the reference mass."""
        return {"formula": self.formulas.model_dump(), "reference_mass_kg": self.reference_mass_kg}

    def terms_left_out(self) -> list[dict[str, Any]]:
        """Each ``term`` that an adapted formula lacks, ``of`` which responses, and the ``reason``."""
        faults = [(fault.term, fault.reason) for gone in self.left_out.values() for fault in gone]
        return [
            {
                "term": term,
                "of": [q for q, gone in self.left_out.items() if term in {fault.term for fault in gone}],
                "reason": reason,
            }
            for term, reason in dict.fromkeys(faults)
        ]


def build_design(
    formulas: Formulas, rows: pd.DataFrame, *, reference_mass_kg: float | None, source: str
) -> Design:
    """Evaluate all formulas over ``rows``, one row an impact (or a cell of the design).

    ``rows`` has the columns ``subject``, ``trial``, ``mass_kg`` and any covariate. The reference row, at
    which the intercepts are reported, has the reference mass and each other covariate's mean.

    A formula left out is the default one less what the rows can't tell.

    Raises:
        InputError: a formula that can't be read, names an unknown column or function, or asks for what
            these rows can't identify: with all that is wrong and the formula that is left without it;
            ``source`` is named as the file.
    """
    mass = rows["mass_kg"].to_numpy(float)
    reference = float(np.exp(np.log(mass).mean())) if reference_mass_kg is None else reference_mass_kg
    problems: list[Problem] = []
    resolved: dict[str, ResolvedFormula] = {}
    left_out: dict[str, tuple[Fault, ...]] = {}
    for response, formula in formulas:
        one = adapted(rows, reference) if formula is None else resolve(formula, rows, reference)
        resolved[response], left_out[response] = one, one.faults if formula is None else ()
        if formula is not None and one.faults:
            problems.append(_refusal(one, formula, f"formula.{response}", source))
    if problems:
        raise InputError(problems)
    terms = (SUBJECT, TRIAL, *(term for one in resolved.values() for term in one.groups))
    groupings = (grouping_of(rows, factors) for factors in dict.fromkeys(term.factors for term in terms))
    written = {response: str(one.terms) for response, one in resolved.items()}
    return Design(
        {response: _response(parameter_of(response), one) for response, one in resolved.items()},
        {grouping.name: grouping for grouping in groupings},
        float(reference),
        Formulas(**written),
        left_out,
        recorded=Recorded.of_rows(rows, written, float(reference)),
    )


def _refusal(resolved: ResolvedFormula, formula: str, key: str, source: str) -> Problem:
    """Everything that is wrong with a formula, and the one that the rows can tell."""
    faults = resolved.faults
    wanted = "; ".join(dict.fromkeys(fault.expected for fault in faults))
    wrong = "; ".join(f"{fault.term}: {fault.reason}" if fault.term else fault.reason for fault in faults)
    at = (source, None, key, formula)
    kind = "mendable" if any(fault.mendable for fault in faults) else "judged"
    return Problem.stated(f"formula.{kind}", *at, wanted=wanted, wrong=wrong, terms=resolved.terms)


def _response(parameter: str, resolved: ResolvedFormula) -> ResponseDesign:
    names, columns = resolved.names, resolved.columns
    log_mass = columns[:, names.index(MASS_TERM)] if MASS_TERM in names else None
    keep = [i for i, name in enumerate(names) if name != MASS_TERM]
    scale = columns[:, keep].std(axis=0)
    terms = {}
    for term, values in resolved.groups.items():
        unit = float(values.std()) if term.slope and term.slope != MASS_TERM else 1.0
        terms[term] = GroupColumn(values / unit, unit)
    independent = tuple(names[i] for i in keep)
    return ResponseDesign(parameter, independent, columns[:, keep] / scale, scale, log_mass, terms)
