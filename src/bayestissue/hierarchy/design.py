"""From formulas and a table of impacts to design matrices, refusing what can't be identified."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from bayestissue.errors import InputError, Problem
from bayestissue.hierarchy.formula import MASS_TERM, Fault, Judged, adapted, judge
from bayestissue.hierarchy.specification import Formulas


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
    """Both responses over the same rows, with the index of each row's subject and trial.

    ``formulas`` are the right-hand sides that were evaluated, ``left_out`` of each response what a formula
    that nobody wrote would have had besides, and why the rows can't tell it.
    """

    responses: dict[str, ResponseDesign]
    subject: np.ndarray
    trial: np.ndarray
    subjects: tuple[str, ...]
    trials: tuple[str, ...]
    reference_mass_kg: float
    formulas: Formulas = field(default_factory=Formulas)
    left_out: Mapping[str, tuple[Fault, ...]] = field(default_factory=dict)

    def resolved(self) -> dict[str, Any]:
        """What ``run.json`` says of the model beside its file: the formulas and the reference mass."""
        return {"formula": self.formulas.model_dump(), "reference_mass_kg": self.reference_mass_kg}

    def terms_left_out(self) -> list[dict[str, Any]]:
        """Each ``term`` that an adapted formula lacks, ``of`` which responses, and the ``reason``."""
        faults = [(fault.term, fault.reason) for found in self.left_out.values() for fault in found]
        return [
            {
                "term": term,
                "of": [q for q, found in self.left_out.items() if term in {fault.term for fault in found}],
                "reason": reason,
            }
            for term, reason in dict.fromkeys(faults)
        ]


def build_design(
    formulas: Formulas, rows: pd.DataFrame, *, reference_mass_kg: float | None, source: str
) -> Design:
    """Evaluate the formulas of log K and log C over ``rows``, one row an impact (or a cell of the design).

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
    found: dict[str, Judged] = {}
    left_out: dict[str, tuple[Fault, ...]] = {}
    for response, formula in (("K", formulas.K), ("C", formulas.C)):
        found[response] = adapted(rows, reference) if formula is None else judge(formula, rows, reference)
        left_out[response] = found[response].faults if formula is None else ()
        if formula is not None and found[response].faults:
            problems.append(_refusal(found[response], formula, f"formula.{response}", source))
    if problems:
        raise InputError(problems)
    subject, subjects = pd.factorize(rows["subject"])
    trial, trials = pd.factorize(rows["trial"])
    return Design(
        {response: _response(judged) for response, judged in found.items()},
        subject,
        trial,
        tuple(map(str, subjects)),
        tuple(map(str, trials)),
        float(reference),
        Formulas(**{response: str(judged.terms) for response, judged in found.items()}),
        left_out,
    )


def _refusal(judged: Judged, formula: str, key: str, source: str) -> Problem:
    """Everything that is wrong with a formula, and the one that the rows can tell."""
    faults = judged.faults
    expected = "; ".join(dict.fromkeys(fault.expected for fault in faults))
    wrong = "; ".join(f"{fault.term}: {fault.reason}" if fault.term else fault.reason for fault in faults)
    remedy = f'What is wrong: {wrong}. Write "{judged.terms}" instead, or leave {key} out.'
    return Problem(source, expected, remedy, column=key, value=formula)


def _response(judged: Judged) -> ResponseDesign:
    names, columns = judged.names, judged.columns
    log_mass = columns[:, names.index(MASS_TERM)] if MASS_TERM in names else None
    keep = [i for i, name in enumerate(names) if name != MASS_TERM]
    scale = columns[:, keep].std(axis=0)
    return ResponseDesign(
        tuple(names[i] for i in keep), columns[:, keep] / scale, scale, log_mass, judged.groups
    )
