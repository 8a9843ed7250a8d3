"""A formula term by term: what it asks for, and what of that a table of impacts can't tell."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

GROUPS = ("subject", "trial")
MASS_TERM = "log(mass_kg)"
DEFAULT_FORMULA = f"{MASS_TERM} + (1|subject) + (1|trial)"
LABELS = ("impact", *GROUPS)
_INTERCEPT = "Intercept"
_TIED = {"mass": {"mass_kg"}, "energy": {"energy_J"}, "velocity": {"velocity_m_s"}}
# The relative precision of a table given to three or four digits: a smaller difference, or a combination of
# columns below it, is rounding and not information.
PRECISION = 1e-3
# Only these functions are within a formula's reach.
FUNCTIONS = {"log": np.log, "sqrt": np.sqrt}


@dataclass(frozen=True)
class Fault:
    """A term that these rows can't tell.

    Attributes:
        term: as it is written, such as ``(1|trial)``; empty where the formula as a whole can't be read.
        expected: what it would take.
        reason: what there is instead, as a clause: "the mass is 0.5 kg in every impact".
    """

    term: str
    expected: str
    reason: str


@dataclass(frozen=True)
class Terms:
    """What a formula asks for, in its own order.

    Attributes:
        common: the terms of covariates, as written.
        variables: the columns that each of them names.
        groups: the group effects, as written.
    """

    common: tuple[str, ...]
    variables: tuple[frozenset[str], ...]
    groups: tuple[str, ...]

    def without(self, gone: Iterable[str]) -> Terms:
        """The same less some terms."""
        gone = set(gone)
        kept = [i for i, name in enumerate(self.common) if name not in gone]
        return Terms(
            tuple(self.common[i] for i in kept),
            tuple(self.variables[i] for i in kept),
            tuple(name for name in self.groups if name not in gone),
        )

    def __str__(self) -> str:
        """The formula that asks for these terms, and an intercept."""
        return " + ".join([*self.common, *self.groups]) or "1"


@dataclass(frozen=True)
class Judged:
    """A formula held against the rows that it is of.

    Attributes:
        terms: those that the rows can tell.
        columns: [row, column], of the covariates, zero at the reference row.
        names: of the columns.
        faults: everything else that the formula asks for, each once.
    """

    terms: Terms
    columns: np.ndarray
    names: tuple[str, ...]
    faults: tuple[Fault, ...]

    @property
    def groups(self) -> tuple[str, ...]:
        """Columns whose levels have effects of their own."""
        return tuple(name for name in GROUPS if _effect_of(name) in self.terms.groups)


def judge(formula: str, rows: pd.DataFrame, reference_mass_kg: float) -> Judged:
    """Read a formula, find every term of it that ``rows`` can't tell, and evaluate the others.

    Args:
        formula: right-hand side, in the notation of R and formulae.
        rows: one an impact (or a cell of the design), with ``subject``, ``trial``, ``mass_kg``, covariates.
        reference_mass_kg: at which, and at every other covariate's mean, the columns are zero.
    """
    try:
        terms, faults = _read(formula)
    except Exception as error:  # formulae raises its own scanner and parser errors, which share no base
        wrong = Fault("", f'a formula such as "{DEFAULT_FORMULA}"', f"{error}")
        found = judge(DEFAULT_FORMULA, rows, reference_mass_kg)
        return replace(found, faults=(wrong,))
    faults += [*_unknown(terms, rows), *_of_groups(terms, rows)]
    terms = terms.without(fault.term for fault in faults)
    faults += _tied(terms)
    terms = terms.without(fault.term for fault in faults)
    while True:
        columns, names, owners, wrong_terms = _evaluated(terms, rows, reference_mass_kg)
        if not wrong_terms:
            wrong_terms = _dependent(terms, columns, names, owners, rows)
        if not wrong_terms:
            return Judged(terms, columns, tuple(names), tuple(faults))
        faults += wrong_terms
        terms = terms.without(fault.term for fault in wrong_terms)


def adapted(rows: pd.DataFrame, reference_mass_kg: float) -> Judged:
    """`DEFAULT_FORMULA` less what ``rows`` can't tell, its faults being what is left out and why.

    Besides what would be refused if it were written out, an effect of the condition is left out where every
    person has one condition and every condition one person: only the sum of the two effects is then told.
    """
    found = judge(DEFAULT_FORMULA, rows, reference_mass_kg)
    people, conditions = rows["subject"].nunique(), rows["trial"].nunique()
    pairs = len(rows[["subject", "trial"]].drop_duplicates())
    if found.groups != GROUPS or not people == conditions == pairs:
        return found
    alike = Fault(
        _effect_of("trial"),
        "people in several conditions, or several people in one",
        "every person has one condition and every condition one person, so that what is a condition's "
        "can't be told from what is the person's",
    )
    again = judge(str(found.terms.without([alike.term])), rows, reference_mass_kg)
    return replace(again, faults=(*found.faults, alike))


def left_out_words(terms: Sequence[Mapping[str, Any]]) -> str:
    """What an adapted formula lacks and why, as a sentence; empty if nothing.

    Args:
        terms: each with its ``term``, ``of`` which responses, and the ``reason``, as ``run.json`` has them.
    """
    if not terms:
        return ""
    told = [
        f"{each['term']}{'' if len(each['of']) > 1 else ' of log ' + each['of'][0]}, since {each['reason']}"
        for each in terms
    ]
    return f"Left out of the formula: {'; '.join(told)}."


def _effect_of(group: str) -> str:
    return f"(1|{group})"


def _read(formula: str) -> tuple[Terms, list[Fault]]:
    import formulae

    description = formulae.model_description(formula)
    names, variables, faults = [], [], []
    if not any(term.name == _INTERCEPT for term in description.common_terms):
        faults.append(
            Fault("", "an intercept, since K at the reference mass is reported", "a 0 or -1 takes it out")
        )
    for term in description.common_terms:
        if term.name == _INTERCEPT:
            continue
        used = frozenset(getattr(term, "var_names", ())) - {""}
        names.append(f"`{term.name}`" if used == {term.name} and not term.name.isidentifier() else term.name)
        variables.append(used)
    groups = tuple(f"({term.name})" for term in description.group_terms)
    return Terms(tuple(names), tuple(variables), groups), faults


def _unknown(terms: Terms, rows: pd.DataFrame) -> list[Fault]:
    usable = [name for name in rows.columns if name != "impact"]
    faults = []
    for term, variables in zip(terms.common, terms.variables, strict=True):
        strange = sorted(variables - set(usable))
        labels = sorted(variables & set(LABELS))
        if strange:
            expected = f"columns of the data: {', '.join(usable)}"
            faults.append(Fault(term, expected, f"there is no column {', '.join(strange)}"))
        elif labels:
            wanted = f"{labels[0]} as a group effect, written {_effect_of(labels[0])}"
            faults.append(Fault(term, wanted, f"{labels[0]} is a name and no covariate"))
    return faults


def _of_groups(terms: Terms, rows: pd.DataFrame) -> list[Fault]:
    faults = []
    for term in terms.groups:
        group = term.removeprefix("(1|").removesuffix(")")
        if group not in GROUPS:
            expected = "no other group effects than (1|subject) and (1|trial)"
            faults.append(Fault(term, expected, "this program knows these two alone"))
            continue
        counts = rows[group].value_counts()
        if len(counts) < 2:
            faults.append(Fault(term, f"more than one {group}", f"there is one {group} only"))
        elif counts.max() < 2:
            faults.append(
                Fault(
                    term,
                    f"several impacts for at least one {group}",
                    f"with one impact of each {group} it can't be told from the impact's own scatter",
                )
            )
    return faults


def _tied(terms: Terms) -> list[Fault]:
    """The last of three terms that E = ½MV² ties together."""
    seen: set[str] = set()
    for term, variables in zip(terms.common, terms.variables, strict=True):
        seen |= {name for name, columns in _TIED.items() if variables & columns}
        if len(seen) == len(_TIED):
            expected = "at most two of mass, energy and velocity, which are tied by E = ½MV²"
            return [Fault(term, expected, "the other two determine it")]
    return []


def _evaluated(
    terms: Terms, rows: pd.DataFrame, reference_mass_kg: float
) -> tuple[np.ndarray, list[str], list[str], list[Fault]]:
    """The columns, their names and the terms that they are of; and what can't be evaluated."""
    try:
        columns, names, owners = _design(terms.common, rows, reference_mass_kg)
    except Exception:  # as in `judge`; each term by itself tells which it is of
        return np.empty((len(rows), 0)), [], [], _unusable(terms, rows, reference_mass_kg)
    owned = [terms.common[place] for place in owners]
    faults = []
    for name in dict.fromkeys(owned):
        mine = columns[:, [owner == name for owner in owned]]
        if not np.isfinite(mine).all():
            faults.append(Fault(name, "finite covariates", "it is not finite for every impact; transform it"))
    return columns, names, owned, faults


def _unusable(terms: Terms, rows: pd.DataFrame, reference_mass_kg: float) -> list[Fault]:
    expected = "terms that can be evaluated: columns, +, :, {arithmetic}, log() and sqrt()"
    faults = []
    for term in terms.common:
        try:
            _design([term], rows, reference_mass_kg)
        except Exception as error:  # as above
            faults.append(Fault(term, expected, f"{error}"))
    # Terms that fail together only: none can be blamed alone.
    return faults or [Fault(term, expected, "these terms can't stand together") for term in terms.common]


def _design(
    terms: Sequence[str], rows: pd.DataFrame, reference_mass_kg: float
) -> tuple[np.ndarray, list[str], list[int]]:
    """Columns less the reference row's, their names, and the number of the term that each is of."""
    import formulae
    from formulae.environment import Environment

    numeric = rows.select_dtypes("number").columns
    at_reference = {name: rows[name].mean() if name in numeric else rows[name].iloc[0] for name in rows}
    reference = pd.DataFrame([at_reference | {"mass_kg": reference_mass_kg}])
    environment = Environment([FUNCTIONS])
    formula = " + ".join(terms) or "1"
    common = formulae.design_matrices(formula, rows, na_action="error", env=environment).common
    with np.errstate(invalid="ignore", divide="ignore"):  # what is not finite is refused
        columns = common.design_matrix - common.evaluate_new_data(reference).design_matrix
    labels = [(label, name) for name, term in common.terms.items() for label in term.labels]
    own = [name for name in common.terms if name != _INTERCEPT]
    keep = [i for i, (_, name) in enumerate(labels) if name != _INTERCEPT]
    return columns[:, keep], [labels[i][0] for i in keep], [own.index(labels[i][1]) for i in keep]


def _dependent(
    terms: Terms, columns: np.ndarray, names: Sequence[str], owners: Sequence[str], rows: pd.DataFrame
) -> list[Fault]:
    """Terms that do not vary; if there are none, the first that those before it determine."""
    flat = [i for i, name in enumerate(names) if _is_flat(columns[:, i], name)]
    # Categories of which there is one have no column.
    still = dict.fromkeys([*(owners[i] for i in flat), *(t for t in terms.common if t not in owners)])
    if still:
        return [_flat(owner, rows) for owner in still]
    centred = columns - columns.mean(axis=0)
    spread = np.linalg.norm(centred, axis=0)
    for count in range(2, len(names) + 1):
        part = centred[:, :count] / spread[:count]
        if np.linalg.svd(part, compute_uv=False)[-1] < PRECISION:
            expected = "covariates that are no combination of each other"
            return [Fault(owners[count - 1], expected, "the terms before it already determine it")]
    return []


def _is_flat(column: np.ndarray, name: str) -> bool:
    """Whether a column has one value, or a log of mass differs by rounding alone."""
    return bool(np.ptp(column) <= (PRECISION if name == MASS_TERM else 0.0))


def _flat(term: str, rows: pd.DataFrame) -> Fault:
    if term != MASS_TERM:
        return Fault(term, "covariates that vary", "it has one value only")
    mass = float(rows["mass_kg"].mean())
    return Fault(term, "a mass that varies over the impacts", f"the mass is {mass:.4g} kg in every impact")
