"""Which group terms the rows of a design can tell apart, from each other and from the impacts' own scatter.

Term k makes the covariance s_k² Z_k Z_k' of the rows, with Z_k the columns of its levels, and the impacts'
own scatter s² 1. The standard deviations are identified where no Z_k Z_k' is a combination of 1 and of others
(Rao and Kleffe 1988, Estimation of Variance Components, section 4.1). Inner products of these matrices are
||Z_k' Z_l||² in the Frobenius norm, sums over the rows' levels.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayestissue.base.declarations import declared, filled
from bayestissue.model.hierarchy.formulas.group_terms import (
    MASS_TERM,
    TRIAL,
    Grouping,
    GroupTerm,
    grouping_of,
)
from bayestissue.recordings.dataset.cells import no_column

# The relative precision of a table given to three or four digits: a smaller difference, or a combination of
# columns below it, is rounding and not information.
PRECISION = 1e-3
# Dimensions of a posterior that are no grouping's; chains and draws stacked are a "sample" to ArviZ.
RESERVED_DIMENSIONS = ("impact", "chain", "draw", "kept_draw", "sample", "time_index")
# Names that a level's K or C would have to share, such as K_new.
RESERVED_STEMS = ("new", "typical_person", "secant", "tangent", "equivalent", "common_depth")
_WORDS = {"subject": "person", "trial": "condition"}
_PLURALS = {"person": "people", "condition": "conditions"}
# Of two levels the squared correlation with the log of mass from which one can't be told from the other: at
# masses of 1 and 2, weights that scatter by less than 1 % within a level.
_SAME_AS_MASS = 0.999
_FAULTS = declared(__package__, "sentences.toml")


@dataclass(frozen=True)
class Fault:
    """A term that these rows can't tell.

    Attributes:
        term: as it is written, such as ``(1|trial)``; empty where the formula as a whole can't be read.
        expected: what it would take.
        reason: what there is instead, as a clause: "the mass is 0.5 kg in every impact".
        mendable: whether the term is told once its name, its form or its column is right: then a formula
            without it is none that anybody asked for.
    """

    term: str
    expected: str
    reason: str
    mendable: bool = False

    @classmethod
    def stated(cls, key: str, term: object, /, **words: object) -> Self:
        """A term that these rows can't tell for the reason of this key of ``sentences.toml``."""
        expected, reason = (filled(_FAULTS[key][part], **words) for part in ("expected", "reason"))
        return cls(str(term), expected, reason, _FAULTS[key].get("mendable", False))


def missing(column: pd.Series) -> pd.Series:
    """Where a column has no value: not a number, or a category that is an empty cell."""
    return column.isna() | column.map(lambda value: isinstance(value, str) and not value.strip()).astype(bool)


def no_columns(term: object, strange: Sequence[str], usable: Sequence[str]) -> Fault:
    """A term of columns that there are not."""
    return Fault.stated("no-column", term, usable=", ".join(usable), strange=no_column(strange, usable))


def lacking(term: str, column: str, rows: pd.DataFrame) -> Fault:
    """A term of a column that is missing in some impacts."""
    without = rows.loc[missing(rows[column]), "impact" if "impact" in rows else column]
    where = f", such as impact {without.iloc[0]}" if "impact" in rows else ""
    return Fault.stated("missing", term, column=column, without=len(without), of=len(rows), where=where)


def written_twice(groups: Sequence[Sequence[GroupTerm]]) -> list[Fault]:
    """Effects that more than one of the parentheses of a formula ask for, each parenthesis' terms given."""
    keys: set[tuple[str, frozenset[str]]] = set()
    faults = []
    for terms in groups:
        by_key = {(term.slope, frozenset(term.factors)): term for term in terms}
        faults += [Fault.stated("twice", "", term=by_key[key]) for key in by_key.keys() & keys]
        keys |= by_key.keys()
    return faults


def unsuited_columns(terms: Sequence[GroupTerm], rows: pd.DataFrame) -> list[Fault]:
    """Terms whose grouping is not made of complete columns, or whose names are another's."""
    faults, stems = [], set()
    taken = (*RESERVED_DIMENSIONS, *RESERVED_STEMS)
    for term in terms:
        strange = [name for name in term.factors if name not in rows.columns]
        holes = [name for name in term.factors if name not in strange and missing(rows[name]).any()]
        if strange:
            usable = [name for name in rows.columns if name not in RESERVED_DIMENSIONS]
            faults.append(no_columns(term, strange, usable))
        elif "impact" in term.factors:
            faults.append(Fault.stated("impact", term))
        elif term.grouping in taken or any("/" in name for name in term.factors):
            faults.append(Fault.stated("taken", term, taken=", ".join(taken[1:])))
        elif holes:
            faults.append(lacking(str(term), holes[0], rows))
        # Levels a:b and c, and a and b:c, would have one name.
        elif (labels := pd.Series(grouping_of(rows, term.factors).levels)).duplicated().any():
            faults.append(Fault.stated("same-label", term, same=labels[labels.duplicated()].iloc[0]))
        elif term.stem in stems:
            faults.append(Fault.stated("same-name", term, stem=term.stem))
        stems.add(term.stem)
    return faults


def unidentified(values: Mapping[GroupTerm, Float[np.ndarray, " row"]], rows: pd.DataFrame) -> list[Fault]:
    """Terms whose standard deviation the rows can't tell, those first that they can't tell by themselves.

    Args:
        values: of each term the covariate whose coefficient it is of, 1 for an intercept.
        rows: one an impact, with complete columns of the terms' factors.
    """
    groupings = {term: grouping_of(rows, term.factors) for term in values}
    coefficients = Counter(term.factors for term in values)
    by_itself = {
        term: _by_itself(term, groupings[term], x, coefficients[term.factors]) for term, x in values.items()
    }
    left = {term: x for term, x in values.items() if by_itself[term] is None}
    return [*filter(None, by_itself.values()), *_alike(left, groupings)]


def confounded_with_mass(term: GroupTerm, rows: pd.DataFrame) -> Fault | None:
    """What a formula with the log of mass and a term of two levels, each of one mass, has to do without.

    A condition says no more than its mass does; for anybody else's levels it is the mass that goes.
    """
    grouping, log_mass = grouping_of(rows, term.factors), np.log(rows["mass_kg"].to_numpy(float))
    if term.slope or len(grouping.levels) != 2 or np.ptp(log_mass) <= PRECISION:
        return None
    if np.corrcoef(grouping.code, log_mass)[0, 1] ** 2 <= _SAME_AS_MASS:
        return None
    one, many = _words(term)
    key, goes = ("mass-of-condition", str(term)) if term == TRIAL else ("mass-of-level", MASS_TERM)
    return Fault.stated(key, goes, one=one, many=many)


def _by_itself(
    term: GroupTerm, grouping: Grouping, x: Float[np.ndarray, " row"], coefficients: int
) -> Fault | None:
    """What a term lacks whatever others there are; so many ``coefficients`` its grouping's levels have."""
    name, counts = grouping.name, np.bincount(grouping.code)
    if not term.slope:
        if len(counts) < 2:
            return Fault.stated("one-level", term, name=name)
        return Fault.stated("one-impact", term, name=name) if counts.max() < 2 else None
    by_level = pd.Series(x).groupby(grouping.code)
    varies = (by_level.max() - by_level.min()) > (PRECISION if term.slope == MASS_TERM else 0.0)
    if varies.sum() < 2:
        what = "the mass" if term.slope == MASS_TERM else term.slope
        variation = "varies within one" if varies.any() else "has one value in every"
        return Fault.stated("too-flat", term, what=what, name=name, variation=variation)
    # What lme4 refuses too: told from the scatter by the assumption alone that both are independent.
    if counts.max() <= coefficients:
        return Fault.stated("saturated", term, coefficients=coefficients, name=name)
    return None


def _alike(
    values: Mapping[GroupTerm, Float[np.ndarray, " row"]], groupings: Mapping[GroupTerm, Grouping]
) -> list[Fault]:
    """Terms whose covariance is a combination of those of the scatter and of the terms before them."""
    from scipy.sparse import csr_array

    faults: list[Fault] = []
    independent: list[GroupTerm] = []
    columns = {
        term: csr_array((np.asarray(x, float), (np.arange(len(x)), groupings[term].code)))
        for term, x in values.items()
    }
    for term in values:
        if _left(columns[term], [columns[t] for t in independent]) > PRECISION**2:
            independent.append(term)
            continue
        same = next((t for t in independent if _same_levels(term, t, groupings)), None)
        if same:
            (mine, several_mine), (its, several_its) = _words(term), _words(same)
            several = {"several_mine": several_mine, "several_its": several_its}
            faults.append(Fault.stated("same-levels", term, mine=mine, its=its, **several))
        else:
            others = ", ".join(map(str, independent))
            faults.append(Fault.stated("combined", term, grouping=term.grouping, others=others))
    return faults


def _left(indicator: Any, others: Sequence[Any]) -> float:
    """The share of Z Z' that is no combination of 1 and the others' Z Z', as a squared norm."""
    from scipy.sparse import eye_array

    indicators = [eye_array(indicator.shape[0], format="csr"), *others, indicator]
    products = np.array([[((left.T @ right).data ** 2).sum() for right in indicators] for left in indicators])
    scale = np.sqrt(np.diag(products))
    products /= np.outer(scale, scale)
    coefficients = np.linalg.lstsq(products[:-1, :-1], products[:-1, -1], rcond=None)[0]
    return float(1 - coefficients @ products[:-1, -1])


def _same_levels(left: GroupTerm, right: GroupTerm, groupings: Mapping[GroupTerm, Grouping]) -> bool:
    if left.slope or right.slope:
        return False
    a, b = groupings[left], groupings[right]
    pairs = len(np.unique(np.stack([a.code, b.code]), axis=1).T)
    return len(a.levels) == len(b.levels) == pairs


def _words(term: GroupTerm) -> tuple[str, str]:
    """What one and what several of a term's levels are called."""
    one = _WORDS.get(term.grouping, term.grouping)
    return one, _PLURALS.get(one, f"levels of {one}")
