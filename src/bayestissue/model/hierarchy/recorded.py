"""What was measured, as formulas need it: what the columns are, and what follows from the level of a group.

A column that is the same in all impacts of each level of a group, as a person's sex is, or the weight of a
person in a session, follows from that level; mass, velocity and trial, which are chosen and no property of a
level, never follow.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayestissue.model.hierarchy.formulas.formula import Covariates, Terms, categories_of_numbers, terms_of
from bayestissue.model.hierarchy.formulas.group_terms import Grouping, GroupTerm, grouping_of, labels_of
from bayestissue.model.hierarchy.formulas.identifiability import RESERVED_DIMENSIONS, RESERVED_STEMS
from bayestissue.recordings.dataset.impact_table import RESERVED

Condition = Mapping[str, str | float]
_CHOSEN = ("mass_kg", "velocity_m_s", "trial")


@dataclass(frozen=True, eq=False)
class Recorded:
    """What was measured, and the formulas over it.

    Attributes:
        rows: one an impact: ``subject``, ``trial``, ``mass_kg``, ``velocity_m_s`` and further columns of
            ``impacts.csv``; categories as text.
        formulas: of each response, as ``run.json`` has them.
        reference_mass_kg: M_ref.
    """

    rows: pd.DataFrame
    formulas: Mapping[str, str]
    reference_mass_kg: float

    @classmethod
    def of_run(cls, constant_data: xr.Dataset, model: Mapping[str, Any]) -> Recorded:
        """Of the group constant_data of a run and the model as ``run.json`` has it resolved."""
        columns = {
            str(array.attrs.get("column", str(name).removeprefix("impact_"))): array.to_numpy()
            for name, array in constant_data.data_vars.items()
            if array.dims == ("impact",)
            and ("column" in array.attrs or name in ("impact_subject", "impact_trial"))
        }
        numbers = {name: constant_data[name].to_numpy() for name in ("mass_kg", "velocity_m_s")}
        texts = {k: v if v.dtype.kind in "fiu" else v.astype(str).astype(object) for k, v in columns.items()}
        formulas = {str(name): str(formula) for name, formula in model["formula"].items()}
        return cls(pd.DataFrame(numbers | texts), formulas, float(model["reference_mass_kg"]))

    @classmethod
    def of_rows(
        cls, impacts: pd.DataFrame, formulas: Mapping[str, str], reference_mass_kg: float
    ) -> Recorded:
        """Of a table of impacts, or of the cells of a design."""
        standard = ["subject", "trial", "mass_kg", "velocity_m_s"]
        rows = impacts[[name for name in impacts if name in standard or name not in RESERVED]]
        return cls(rows.reset_index(drop=True), formulas, reference_mass_kg)

    @cached_property
    def responses(self) -> dict[str, ResponseFormula]:
        """The formula of each response."""
        return {name: ResponseFormula(self, formula) for name, formula in self.formulas.items()}

    def response(self, name: str) -> ResponseFormula:
        """The formula of a response; without terms where it has none."""
        return self.responses.get(name) or ResponseFormula(self, "1")

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """The columns that the formulas are of."""
        return tuple(dict.fromkeys(name for one in self.responses.values() for name in one.terms.columns))

    @cached_property
    def terms(self) -> tuple[GroupTerm, ...]:
        """The group terms of all formulas, each once."""
        return tuple(dict.fromkeys(term for one in self.responses.values() for term in one.terms.groups))

    @cached_property
    def factors(self) -> frozenset[str]:
        """The columns that group terms are of, and the person."""
        return frozenset({"subject", *(factor for term in self.terms for factor in term.factors)})

    @cached_property
    def named(self) -> tuple[str, ...]:
        """The columns whose values are names: categories, and what formulas group by."""
        return tuple(str(name) for name in self.rows if name in self.factors or self.is_category(str(name)))

    def is_number(self, column: str) -> bool:
        """Whether a column holds numbers."""
        return bool(pd.api.types.is_numeric_dtype(self.rows[column]))

    def is_category(self, column: str) -> bool:
        """Whether a column's values are categories: text, or numbers that a formula has in ``C()``."""
        coded = (column in categories_of_numbers(formula) for formula in self.formulas.values())
        return any(coded) or not self.is_number(column)

    def may_be_new(self, column: str) -> bool:
        """Whether a column may have a level that was not recorded: a group's, but no covariate's category."""
        categories = {name for one in self.responses.values() for name in one.categories}
        return column in self.factors and column not in categories

    def labels(self, column: str) -> np.ndarray:
        """The value of a column in every row, as levels are called."""
        if column not in self._labels:
            self._labels[column] = labels_of(self.rows[column])
        return self._labels[column]

    def levels(self, column: str, condition: Condition | None = None) -> list[str]:
        """The levels of a column, of those recorded in a condition, in order of appearance."""
        return list(dict.fromkeys(self.labels(column)[self.matching(condition or {})]))

    def matching(self, condition: Condition) -> np.ndarray:
        """Whether each row has these values."""
        keep = np.ones(len(self.rows), bool)
        for column, value in condition.items():
            keep &= self.labels(column) == label_of(value)
        return keep

    def completed(self, condition: Condition) -> dict[str, Any]:
        """The condition with the columns that follow from it: see the module."""
        complete = dict(condition)
        for factors, followers in self._followers.items():
            if followers and complete.keys() >= set(factors):
                rows = self.rows[self.matching({name: complete[name] for name in factors})]
                if len(rows):
                    complete = {name: rows[name].iloc[0] for name in followers} | complete
        return complete

    def followers(self, *columns: str) -> tuple[str, ...]:
        """The columns that follow from levels of groups in these columns; none from numbers or covariates."""
        known = set(columns)
        for factors, followers in self._followers.items():
            if known >= set(factors):
                known |= set(followers)
        return tuple(str(name) for name in self.rows if name in known and name not in columns)

    @property
    def tells_people(self) -> bool:
        """Whether a formula has the person, or something that follows from the person."""
        return bool({"subject", *self.followers("subject")} & set(self.needed))

    @cached_property
    def _followers(self) -> dict[tuple[str, ...], tuple[str, ...]]:
        """What follows from a level of each group, those of one column first."""
        single = [(name,) for name in self.named if name in (*self.factors, "trial")]
        several = dict.fromkeys(term.factors for term in self.terms if len(term.factors) > 1)
        others = [str(name) for name in self.rows if name not in _CHOSEN]
        followers = {}
        for factors in (*single, *sorted(several, key=len)):
            if set(factors) <= set(self.rows):
                by = grouping_of(self.rows, factors).code
                constant = self.rows[others].groupby(by).nunique(dropna=False).eq(1).all()
                followers[factors] = tuple(n for n in others if n not in factors and constant[n])
        return followers

    def conditions_of(self, grouping: Grouping) -> list[Condition]:
        """The condition of each level of a grouping; those of trials have what was chosen in them too."""
        first = np.unique(grouping.code, return_index=True)[1]
        columns = {name: self.labels(name)[first] for name in grouping.factors}
        if grouping.factors == ("trial",):
            chosen = [name for name in _CHOSEN if name in self.rows and name != "trial"]
            means = self.rows[chosen].apply(np.log).groupby(grouping.code).mean().apply(np.exp)
            columns |= {name: means[name].to_numpy() for name in chosen}
        return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]

    @cached_property
    def _labels(self) -> dict[str, np.ndarray]:
        return {}


@dataclass(frozen=True, eq=False)
class ResponseFormula:
    """The formula of one response: what it depends on, and over which categories it is averaged.

    Attributes:
        recorded: what it is evaluated over.
        formula: its text.
    """

    recorded: Recorded
    formula: str

    @property
    def terms(self) -> Terms:
        """What it asks for."""
        return terms_of(self.formula)

    @cached_property
    def _evaluated(self) -> tuple[Covariates, dict[GroupTerm, Covariates | None]]:
        """Its covariates, and those of its group terms that have one."""
        table = self.recorded.rows, self.recorded.reference_mass_kg
        of_groups = {t: Covariates([t.slope], *table) if t.slope else None for t in self.terms.groups}
        return Covariates(self.terms.common, *table), of_groups

    def at(self, rows: pd.DataFrame) -> tuple[dict[str, np.ndarray], dict[GroupTerm, np.ndarray]]:
        """In any rows its covariates by name, and what each group term's effects are multiplied by, [row]."""
        covariates, of_groups = self._evaluated
        ones, columns = np.ones(len(rows)), dict(zip(covariates.names, covariates.at(rows).T, strict=True))
        return columns, {t: x.at(rows)[:, 0] if x else ones for t, x in of_groups.items()}

    @cached_property
    def covariates(self) -> tuple[str, ...]:
        """The columns of its covariates."""
        return tuple(dict.fromkeys(name for names in self.terms.common.values() for name in sorted(names)))

    @cached_property
    def categories(self) -> tuple[str, ...]:
        """Those of them that are categories."""
        return tuple(name for name in self.covariates if self.recorded.is_category(name))

    @property
    def named_by(self) -> tuple[str, ...]:
        """Those categories of whose levels a variable of the posterior is."""
        groupings = ("subject", "trial", *(term.grouping for term in self.recorded.terms))
        taken = {*RESERVED_DIMENSIONS, *RESERVED_STEMS, *groupings}
        return tuple(name for name in self.categories if name not in taken and "/" not in name)

    def spread(self, condition: Condition) -> list[dict[str, Any]]:
        """A condition in each combination of the categories that it does not give."""
        rows = self.recorded.rows
        free = {n: rows[n].drop_duplicates().tolist() for n in self.categories if n not in condition}
        return [dict(condition) | dict(zip(free, values, strict=True)) for values in product(*free.values())]

    def within(self, term: GroupTerm, known: Iterable[str]) -> tuple[str, ...]:
        """The factors of a term whose levels lie in known ones; none where the term's effect is typical."""
        left = tuple(factor for factor in term.factors if factor not in set(known))
        single = {group.factors[0] for group in self.terms.groups if len(group.factors) == 1}
        return () if len(left) == len(term.factors) or {"subject", *single} & set(left) else left

    def averaged(self, columns: Iterable[str]) -> tuple[str, ...]:
        """The columns whose levels the response is averaged over where these columns are given."""
        columns = set(columns)
        known = columns.union(self.recorded.followers(*columns))
        within = [name for term in self.terms.groups for name in self.within(term, known)]
        return tuple(dict.fromkeys(name for name in (*self.categories, *within) if name not in known))


def label_of(value: Any) -> str:
    """A value as levels are called, see `bayestissue.model.hierarchy.formulas.group_terms.labels_of`."""
    return f"{value:.12g}" if isinstance(value, float) else str(value)
