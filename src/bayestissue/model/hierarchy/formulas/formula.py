"""A formula term by term: what it asks for, and what of that a table of impacts can't tell."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.base.errors import Coded
from bayestissue.model.hierarchy.formulas.group_terms import (
    MASS_TERM,
    SUBJECT,
    TRIAL,
    GroupTerm,
    grouping_of,
    written,
)
from bayestissue.model.hierarchy.formulas.identifiability import (
    PRECISION,
    Fault,
    confounded_with_mass,
    lacking,
    missing,
    no_columns,
    unidentified,
    unsuited_columns,
    written_twice,
)
from bayestissue.recordings.dataset.cells import in_whatever_case

GROUPS = (SUBJECT.grouping, TRIAL.grouping)
DEFAULT_FORMULA = f"{MASS_TERM} + {SUBJECT} + {TRIAL}"
LABELS = ("impact", *GROUPS)
_INTERCEPT = "Intercept"
_TIED = {"mass": {"mass_kg"}, "energy": {"energy_J"}, "velocity": {"velocity_m_s"}}
# Only these functions are within a formula's reach.
FUNCTIONS = {"log": np.log, "sqrt": np.sqrt}
_QUOTED = re.compile(r"`[^`]*`|\"[^\"]*\"|'[^']*'")
# Names, or what is in quotation marks, which is no name; no function.
_NAMED = re.compile(rf"{_QUOTED.pattern}|(?<![\w.])[^\W\d][\w.]*\b(?!\s*\()")
_CALLED = re.compile(r"([^\W\d][\w.]*)\s*\(")


@dataclass(frozen=True)
class Terms:
    """What a formula asks for, in its own order.

    Attributes:
        common: the terms of covariates, as written, and the columns that each names.
        groups: the group terms.
        slopes: the columns that each covariate in a group term names.
    """

    common: Mapping[str, frozenset[str]]
    groups: tuple[GroupTerm, ...]
    slopes: Mapping[str, frozenset[str]]

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of covariates, slopes and groups, each once."""
        named = [name for names in (*self.common.values(), *self.slopes.values()) for name in sorted(names)]
        return tuple(dict.fromkeys([*named, *(name for term in self.groups for name in term.factors)]))

    def without(self, gone: Iterable[str]) -> Terms:
        """The same less some terms."""
        gone = set(gone)
        common = {name: columns for name, columns in self.common.items() if name not in gone}
        return Terms(common, tuple(term for term in self.groups if str(term) not in gone), self.slopes)

    def __str__(self) -> str:
        """The formula that asks for these terms, and an intercept."""
        return " + ".join([*self.common, *written(self.groups)]) or "1"


@dataclass(frozen=True)
class ResolvedFormula:
    """A formula held against the rows that it is of.

    Attributes:
        terms: those that the rows can tell.
        columns: [row, column], of the covariates, zero at the reference row.
        names: of the columns.
        groups: of each group term the covariate whose coefficient it is of, [row]: 1 for an intercept, and
            else zero at the reference row.
        faults: everything else that the formula asks for, each once.
    """

    terms: Terms
    columns: np.ndarray
    names: tuple[str, ...]
    groups: Mapping[GroupTerm, Float[np.ndarray, " row"]]
    faults: tuple[Fault, ...]


def resolve(formula: str, rows: pd.DataFrame, reference_mass_kg: float) -> ResolvedFormula:
    """Read a formula, find every term of it that ``rows`` can't tell, and evaluate the others.

    Args:
        formula: right-hand side, in the notation of R and formulae.
        rows: one an impact (or a cell of the design), with ``subject``, ``trial``, ``mass_kg``, covariates.
        reference_mass_kg: at which, and at every other covariate's mean, the columns are zero.
    """
    formula = _NAMED.sub(lambda match: in_whatever_case(match[0], map(str, rows.columns)), formula)
    try:
        terms, faults = _read(formula)
    except Exception as error:  # formulae's algebra of terms raises errors that share no base
        wrong = Fault("", f'a formula such as "{DEFAULT_FORMULA}"', _unread(formula, error), mendable=True)
        default = resolve(DEFAULT_FORMULA, rows, reference_mass_kg)
        return replace(default, faults=(wrong,))
    faults += [*_unknown(terms, rows), *unsuited_columns(terms.groups, rows)]
    terms = terms.without(fault.term for fault in faults)
    groups, wrong_groups = _covariates_of_groups(terms, rows, reference_mass_kg)
    faults += [*wrong_groups, *unidentified(groups, rows), *_tied(terms)]
    terms = terms.without(fault.term for fault in faults)
    while isinstance(covariates := _evaluated(terms, rows, reference_mass_kg), list):
        faults += covariates
        terms = terms.without(fault.term for fault in covariates)
    of_groups, names = {term: groups[term] for term in terms.groups}, tuple(covariates.names)
    return ResolvedFormula(terms, covariates.columns, names, of_groups, tuple(faults))


def _unread(formula: str, error: Exception) -> str:
    """Why a formula can't be read, and where."""
    from bayestissue.model.hierarchy.formulas.notation import NotationError

    bare = _QUOTED.sub("", formula)
    if "~" in bare:
        return "~ says what is explained, which is log K or log C: leave it out, and what is before"
    if isinstance(error, RecursionError):
        return "it is too long, or has too many parentheses within one another"
    if not formula.strip():
        return "it is empty; 1 stands for no covariate and no group"
    words = str(error) if isinstance(error, NotationError) else "its terms can't stand together like this"
    if mark := re.search("[\"'`]", bare):
        return f"a quotation mark is not closed: {mark[0]}; {words}"
    for opening, closing in ("()", "[]", "{}"):
        if bare.count(opening) != bare.count(closing):
            return (
                f"it has {bare.count(opening)} of {opening} and {bare.count(closing)} of {closing}; {words}"
            )
    return words


def adapted(rows: pd.DataFrame, reference_mass_kg: float) -> ResolvedFormula:
    """`DEFAULT_FORMULA` less what ``rows`` can't tell, its faults being what is left out and why.

    Of two masses, one for each of two conditions, the exponent takes up all that differs between these.
    """
    resolved = resolve(DEFAULT_FORMULA, rows, reference_mass_kg)
    gone = next(filter(None, (confounded_with_mass(term, rows) for term in resolved.groups)), None)
    if gone is None or MASS_TERM not in resolved.terms.common:
        return resolved
    left = resolve(str(resolved.terms.without([gone.term])), rows, reference_mass_kg)
    return replace(left, faults=(*resolved.faults, gone))


@lru_cache
def terms_of(formula: str | None) -> Terms:
    """What a formula asks for, the default one where there is none; nothing if it can't be read."""
    try:
        return _read(formula or DEFAULT_FORMULA)[0]
    except Exception:  # as in `resolve`, which says what is wrong
        return Terms({}, (), {})


def left_out_words(terms: Sequence[Mapping[str, Any]]) -> str:
    """What an adapted formula lacks and why, as a sentence; empty if nothing.

    Args:
        terms: each with its ``term``, ``of`` which responses, and the ``reason``, as ``run.json`` has them.
    """
    if not terms:
        return ""
    sentences = [
        f"{term['term']}{'' if len(term['of']) > 1 else ' of log ' + term['of'][0]}, since {term['reason']}"
        for term in terms
    ]
    return Coded.stated("left-out-of-formula", terms="; ".join(sentences))


def _read(formula: str) -> tuple[Terms, list[Fault]]:
    from bayestissue.model.hierarchy.formulas.notation import described, parentheses, parsed, text_of

    description = described(formula)
    common, faults = {}, []
    if not any(term.name == _INTERCEPT for term in description.common_terms):
        faults.append(Fault.stated("no-intercept", ""))
    for term in description.common_terms:
        if term.name == _INTERCEPT:
            continue
        common[text_of(term)] = _columns_of(term)
    faults += written_twice([_groups(part) for part in parentheses(parsed(formula))])
    groups = {frozenset((*term.factors, f"|{term.slope}")): term for term in reversed(_groups(description))}
    slopes = {
        text_of(term.expr): _columns_of(term.expr)
        for term in description.group_terms
        if term.expr.name != _INTERCEPT
    }
    return Terms(common, tuple(reversed(groups.values())), slopes), faults


def _columns_of(term: Any) -> frozenset[str]:
    return frozenset(getattr(term, "var_names", ())) - {""}


def _groups(description: Any) -> list[GroupTerm]:
    """The group terms of a resolved formula."""
    from bayestissue.model.hierarchy.formulas.notation import text_of

    return [
        GroupTerm(
            tuple(str(part.name) for part in term.factor.components),
            "" if term.expr.name == _INTERCEPT else text_of(term.expr),
        )
        for term in description.group_terms
    ]


def _unknown(terms: Terms, rows: pd.DataFrame) -> list[Fault]:
    usable = [name for name in rows.columns if name != "impact"]
    faults = []
    for group in terms.groups:
        if called := _no_functions(group.slope):
            faults.append(Fault.stated("no-function", group, name=called[0]))
        elif strange := sorted(terms.slopes.get(group.slope, frozenset()) - set(usable)):
            faults.append(no_columns(group, strange, usable))
    for term, variables in terms.common.items():
        strange = sorted(variables - set(usable))
        labels = sorted(variables & set(LABELS))
        holes = [name for name in sorted(variables & set(usable)) if missing(rows[name]).any()]
        if called := _no_functions(term):
            faults.append(Fault.stated("no-function", term, name=called[0]))
        elif strange:
            faults.append(no_columns(term, strange, usable))
        elif labels:
            faults.append(Fault.stated("label", term, name=labels[0]))
        elif holes:
            faults.append(lacking(term, holes[0], rows))
    return faults


def _no_functions(term: str) -> list[str]:
    """The names of what a term calls that there is not."""
    return sorted({*_CALLED.findall(_QUOTED.sub("", term))} - {*FUNCTIONS, "C", "I"})


def _covariates_of_groups(
    terms: Terms, rows: pd.DataFrame, reference_mass_kg: float
) -> tuple[dict[GroupTerm, Float[np.ndarray, " row"]], list[Fault]]:
    """Of each group term the covariate whose coefficient it is of, and the terms that have no such number."""
    values, faults = {}, []
    for term in terms.groups:
        if not term.slope:
            values[term] = np.ones(len(rows))
            continue
        try:
            of_slope = Covariates([term.slope], rows, reference_mass_kg)
        except Exception:  # as in `resolve`
            faults.append(Fault.stated("no-slope", term))
            continue
        if of_slope.names not in ([term.slope.replace("`", "")], [term.slope]):
            faults.append(Fault.stated("slope-of-category", term, slope=term.slope))
        elif not _is_finite(of_slope.columns):
            faults.append(Fault.stated("infinite-slope", term, slope=term.slope))
        else:
            values[term] = of_slope.columns[:, 0]
    return values, faults


def _is_finite(columns: np.ndarray) -> bool:
    """Whether all are numbers, whose fourth powers are numbers too: see `identifiability`."""
    return bool((np.abs(columns) < np.finfo(float).max ** 0.25).all())


def _aliased(terms: Terms, covariates: Covariates, rows: pd.DataFrame) -> list[Fault]:
    """Group terms whose levels the terms of categories alone determine, text or in ``C()``.

    With Z of the levels and X of an intercept and the categories, that is rank [X, Z] = rank X: effects of
    the levels are combinations of the categories'. What the categories do could then be told from what the
    levels do by the prior of their spread alone.
    """

    def is_category(term: str) -> bool:
        coded = categories_of_numbers(term)
        return all(c in coded or not pd.api.types.is_numeric_dtype(rows[c]) for c in terms.common[term])

    of_categories = [i for i, term in enumerate(covariates.terms) if is_category(term)]
    names = [" and ".join(sorted(terms.common[covariates.terms[i]])) for i in of_categories]
    columns = covariates.columns[:, of_categories]
    X = np.column_stack([np.ones(len(rows)), columns])
    X = X / np.linalg.norm(X, axis=0)
    faults = []
    for term in terms.groups:
        grouping = grouping_of(rows, term.factors)
        if term.slope or not names or len(grouping.levels) > len(X.T):
            continue
        levels = (grouping.code[:, None] == np.arange(len(grouping.levels))).astype(float)
        left = levels - X @ np.linalg.lstsq(X, levels, rcond=None)[0]
        if np.linalg.norm(left, axis=0).max() > PRECISION:
            continue
        first = columns[np.unique(grouping.code, return_index=True)[1]]
        within = np.abs(columns - first[grouping.code]).max(axis=0) <= PRECISION
        constant_names = [name for name, constant in zip(names, within, strict=True) if constant]
        categories = " and ".join(dict.fromkeys(constant_names or names))
        faults.append(Fault.stated("categories", term, grouping=term.grouping, categories=categories))
    return faults


def _tied(terms: Terms) -> list[Fault]:
    """The last of three terms that E = ½MV² ties together."""
    physical: set[str] = set()
    for term, variables in terms.common.items():
        physical |= {name for name, columns in _TIED.items() if variables & columns}
        if len(physical) == len(_TIED):
            return [Fault.stated("tied", term)]
    return []


def _evaluated(terms: Terms, rows: pd.DataFrame, reference_mass_kg: float) -> Covariates | list[Fault]:
    """The covariates, or what is wrong with some of them."""
    try:
        covariates = Covariates(terms.common, rows, reference_mass_kg)
    except Exception:  # as in `resolve`; each term by itself tells which it is of
        return _unusable(terms, rows, reference_mass_kg)
    columns, owners = covariates.columns, np.array(covariates.terms)
    infinite = [term for term in dict.fromkeys(owners.tolist()) if not _is_finite(columns[:, owners == term])]
    faults = [Fault.stated("infinite", term) for term in infinite]
    return faults or _dependent(terms, covariates, rows) or _aliased(terms, covariates, rows) or covariates


def _unusable(terms: Terms, rows: pd.DataFrame, reference_mass_kg: float) -> list[Fault]:
    faults = []
    for term in terms.common:
        try:
            Covariates([term], rows, reference_mass_kg)
        except Exception:  # as above
            faults.append(Fault.stated("unusable", term))
    # Terms that fail together only: none can be blamed alone.
    return faults or [Fault.stated("together", term) for term in terms.common]


def reference_row(
    rows: pd.DataFrame, reference_mass_kg: float, categories: Container[str] = ()
) -> dict[str, Any]:
    """Where every column of a design is zero: the reference mass, means of numbers, the first categories.

    Columns named in ``categories`` are such, also where they hold numbers: see `categories_of_numbers`.
    """
    numeric = [name for name in rows.select_dtypes("number").columns if name not in categories]
    at = {str(name): rows[name].mean() if name in numeric else rows[name].iloc[0] for name in rows}
    return at | {"mass_kg": reference_mass_kg}


@lru_cache
def categories_of_numbers(formula: str) -> frozenset[str]:
    """The columns that a formula takes as categories whatever they hold: ``C(session)``."""
    from bayestissue.model.hierarchy.formulas.notation import described

    parts = [part for term in described(formula).common_terms for part in getattr(term, "components", ())]
    return frozenset().union(*(_columns_of(part) for part in parts if str(part.name).startswith("C(")))


@lru_cache
def interactions(formula: str) -> tuple[tuple[str, ...], ...]:
    """The columns of each covariate term ``a:b`` or ``a:b:c``, as the formula has them, each set once."""
    import formulae

    interactions: dict[frozenset[str], tuple[str, ...]] = {}
    for term in formulae.model_description(formula).common_terms:
        parts = [_columns_of(part) for part in getattr(term, "components", ())]
        names = frozenset().union(*parts)
        if len(names) == len(parts) in (2, 3) and all(len(columns) == 1 for columns in parts):
            interactions.setdefault(names, tuple(map(min, parts)))
    return tuple(interactions.values())


class Covariates:
    """Columns of terms of covariates, zero at the reference row, in the rows that fix them and in others.

    Attributes:
        names: of the columns.
        terms: which of the terms each column is of.
        columns: [row, column].
    """

    def __init__(self, terms: Iterable[str], rows: pd.DataFrame, reference_mass_kg: float) -> None:
        """Evaluate terms; ``rows`` fix categories and what transforms remember of their columns.

        Raises:
            Exception: of many kinds, where formulae can't evaluate them.
        """
        from formulae.environment import Environment
        from formulae.matrices import CommonEffectsMatrix

        from bayestissue.model.hierarchy.formulas.notation import described

        written_terms = list(terms)
        formula = " + ".join(written_terms) or "1"
        description = described(formula)
        asked_for = [term for term in description.common_terms if term.name != _INTERCEPT]
        data = rows[[name for name in rows if name in description.var_names]]
        if data.isna().any(axis=None):
            raise ValueError(formula)
        environment = Environment([FUNCTIONS])
        reference = pd.DataFrame([reference_row(rows, reference_mass_kg, categories_of_numbers(formula))])
        with np.errstate(all="ignore"):  # what is not finite is refused
            description.eval(data, environment)
            self._evaluated = CommonEffectsMatrix(description.common_terms)
            self._evaluated.evaluate(data, environment)
            self._reference = self._evaluated.evaluate_new_data(reference).design_matrix
        owners: list[tuple[str, str]] = []
        for term in description.common_terms:
            owner = _INTERCEPT if term.name == _INTERCEPT else written_terms[0]
            owners += [(owner, label) for label in term.labels]
            # What a:b alone needs besides to be of full rank stands before it.
            if any(term is mine for mine in asked_for):
                del written_terms[0]
        self._kept = [column for column, (owner, _) in enumerate(owners) if owner != _INTERCEPT]
        self.terms, self.names = ([owners[column][part] for column in self._kept] for part in (0, 1))
        self.columns = self._less_reference(self._evaluated)

    def _less_reference(self, matrix: Any) -> Float[np.ndarray, "row column"]:
        with np.errstate(all="ignore"):
            return (matrix.design_matrix - self._reference)[:, self._kept]

    def at(self, rows: pd.DataFrame) -> Float[np.ndarray, "row column"]:
        """The columns in other rows, whose categories are among those of the first."""
        return self._less_reference(self._evaluated.evaluate_new_data(rows))


def _dependent(terms: Terms, covariates: Covariates, rows: pd.DataFrame) -> list[Fault]:
    """Terms that do not vary; if there are none, the first that those before it determine."""
    columns, owners = covariates.columns, covariates.terms
    # A log of mass may differ by rounding alone.
    least = [PRECISION if name == MASS_TERM else 0.0 for name in covariates.names]
    flat = np.flatnonzero(np.ptp(columns, axis=0) <= least).tolist()
    # Categories of which there is one have no column.
    still = dict.fromkeys([*(owners[i] for i in flat), *(t for t in terms.common if t not in owners)])
    if still:
        mass = float(rows["mass_kg"].mean())
        return [Fault.stated("one-mass" if t == MASS_TERM else "flat", t, mass=mass) for t in still]
    centred = columns - columns.mean(axis=0)
    spread = np.linalg.norm(centred, axis=0)
    for count in range(2, len(owners) + 1):
        part = centred[:, :count] / spread[:count]
        if np.linalg.svd(part, compute_uv=False)[-1] < PRECISION:
            return [Fault.stated("dependent", owners[count - 1])]
    return []
