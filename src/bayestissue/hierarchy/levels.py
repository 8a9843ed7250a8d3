"""K, C or a further parameter at given levels: of a person, a side, a covariate, a new level of a group.

With the formula's covariates x and group terms z b, the expected log of a response is

    log q = intercept + exponent log(M / M_ref) + sum_k effect_k x_k + sum_g z_g b_g(level),

and q itself the median of impacts there. What is not given is

- at the reference: the reference mass, the mean of other numbers;
- averaged: log q over the recorded categories of a covariate, such as sides, each with equal weight; and the
  effects of levels that lie in a given one, such as a person's own sides;
- typical: an effect of 0 of a group's level, such as of a person or a session.

But a column that is the same in all impacts of each level of a given group, as a person's sex is, or the
weight of a person in a session, has that level's value; mass, velocity and trial, which are chosen and no
property of a level, never follow. There is no other way to a value: variables such as K_subject, contrasts,
answers and predictions are all `log_at_levels`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.dataset.impacts import RESERVED
from bayestissue.errors import Coded
from bayestissue.hierarchy.effects import intercept, parameter_of
from bayestissue.hierarchy.formulas.formula import (
    categories_of_numbers,
    columns_named,
    evaluated_at,
    group_terms,
    reference_row,
    variables_of_terms,
)
from bayestissue.hierarchy.formulas.group_terms import (
    Grouping,
    GroupTerm,
    common_coefficient,
    grouping_of,
    labels_of,
)
from bayestissue.hierarchy.formulas.identifiability import RESERVED_DIMENSIONS, RESERVED_STEMS

Condition = Mapping[str, str | float]
# What questions and tables call a level that was not measured.
NEW = "new"
# What `bayestissue init` fills besides: counts of repeats, and heights that became velocities.
_COUNTS = ("n", "drop_height_m", "drop_height_cm", "drop_height_mm")
_USUAL = ("subject", "trial", "mass_kg", "velocity_m_s", "energy_J", "diameter_m", "sampling_rate_hz")
_DATE = r"(19|20)\d{6}|\d{4}-\d\d?-\d\d?([T ].*)?|\d\d?[./]\d\d?[./]\d{2,4}( .*)?|\d\d?:\d\d(:\d\d.*)?"
# So many whole numbers may be codes.
_FEW = 6
# Chosen by who measures, and no property of a person or a side.
_CHOSEN = ("mass_kg", "velocity_m_s", "trial")


@dataclass(frozen=True, eq=False)
class Recorded:
    """What was measured, as formulas need it.

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
    def needed(self) -> tuple[str, ...]:
        """The columns that the formulas are of."""
        return tuple(
            dict.fromkeys(name for formula in self.formulas.values() for name in columns_named(formula))
        )

    @cached_property
    def few_valued(self) -> dict[str, list[str]]:
        """The columns, and their values, that may be codes: three to six whole numbers, and no count."""
        columns = [name for name in map(str, self.rows) if name not in (*_USUAL, *_COUNTS)]
        known = {name: self.rows[name].dropna() for name in columns if self.is_number(name)}
        return {
            name: labels_of(values.drop_duplicates().sort_values()).tolist()
            for name, values in known.items()
            if 3 <= values.nunique() <= _FEW and (values % 1 == 0).all()
        }

    @cached_property
    def not_used(self) -> tuple[str, ...]:
        """The columns that vary and that no formula is of, besides what every study has, and mere labels."""
        others = [name for name in map(str, self.rows) if name not in (*_USUAL, *_COUNTS, *self.needed)]
        return tuple(n for n in others if len(self.levels(n)) > 1 and not self._is_label(n))

    def _is_label(self, column: str) -> bool:
        """Whether a column tells impacts apart and no more: a name or a remark of nearly each, or a date."""
        labels = pd.Series(labels_of(self.rows[column]))
        if labels.str.fullmatch(_DATE).all():
            return True
        counted = not self.is_number(column) or pd.api.types.is_integer_dtype(self.rows[column])
        return counted and labels.nunique() > max(len(labels) / 2, 2)

    @cached_property
    def lacking(self) -> tuple[str, ...]:
        """Columns of the formulas that an earlier version of the program did not keep."""
        return tuple(name for name in self.needed if name not in self.rows)

    @cached_property
    def reference(self) -> dict[str, Any]:
        """The reference row: see `bayestissue.hierarchy.formulas.formula.reference_row`."""
        return reference_row(self.rows, self.reference_mass_kg)

    def is_category(self, column: str) -> bool:
        """Whether a column's values are categories: text, or numbers that a formula has in ``C()``."""
        coded = (column in categories_of_numbers(formula) for formula in self.formulas.values())
        return any(coded) or not self.is_number(column)

    def is_number(self, column: str) -> bool:
        """Whether a column holds numbers."""
        return bool(pd.api.types.is_numeric_dtype(self.rows[column]))

    def levels(self, column: str, rows: pd.DataFrame | None = None) -> list[str]:
        """The levels of a column, in some of the rows, in order of appearance, as effects call them."""
        return list(dict.fromkeys(labels_of((self.rows if rows is None else rows)[column])))

    def matching(self, condition: Condition) -> pd.DataFrame:
        """The recorded rows that have these values."""
        keep = np.ones(len(self.rows), bool)
        for column, value in condition.items():
            keep &= labels_of(self.rows[column]) == label_of(value)
        return self.rows[keep]

    def completed(self, condition: Condition) -> dict[str, Any]:
        """The condition with the columns that follow from it: see the module."""
        complete = dict(condition)
        for factors, followers in self._followers.items():
            if followers and complete.keys() >= set(factors):
                rows = self.matching({name: complete[name] for name in factors})
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

    @cached_property
    def named(self) -> tuple[str, ...]:
        """The columns whose values are names: categories, and what formulas group by."""
        return tuple(str(name) for name in self.rows if name in self.factors or self.is_category(str(name)))

    @cached_property
    def terms(self) -> tuple[GroupTerm, ...]:
        """The group terms of all formulas, each once."""
        return tuple(
            dict.fromkeys(term for formula in self.formulas.values() for term in group_terms(formula))
        )

    @cached_property
    def factors(self) -> frozenset[str]:
        """The columns that group terms are of, and the person."""
        return frozenset({"subject", *(factor for term in self.terms for factor in term.factors)})

    def categories(self, response: str) -> tuple[str, ...]:
        """The covariates of a response that are categories."""
        variables = variables_of_terms(self.formulas.get(response, "1"))
        named = dict.fromkeys(name for columns in variables for name in sorted(columns))
        return tuple(name for name in named if self.is_category(name))

    def named_by(self, response: str) -> tuple[str, ...]:
        """The covariates with categories of whose levels a variable of the posterior is."""
        groupings = ("subject", "trial", *(term.grouping for term in self.terms))
        taken = {*RESERVED_DIMENSIONS, *RESERVED_STEMS, *groupings}
        return tuple(n for n in self.categories(response) if n not in taken and "/" not in n)

    def conditions_of(self, grouping: Grouping) -> list[Condition]:
        """The condition of each level of a grouping; those of trials have what was chosen in them too."""
        first = np.unique(grouping.code, return_index=True)[1]
        labels = zip(*(labels_of(self.rows[name].iloc[first]) for name in grouping.factors), strict=True)
        conditions: list[Condition] = [
            dict(zip(grouping.factors, condition, strict=True)) for condition in labels
        ]
        if grouping.factors != ("trial",):
            return conditions
        chosen = self.rows[[name for name in ("mass_kg", "velocity_m_s") if name in self.rows]]
        means = chosen.apply(np.log).groupby(grouping.code).mean().apply(np.exp).to_dict("records")
        return [
            {**condition, **{str(k): float(v) for k, v in mean.items()}}
            for condition, mean in zip(conditions, means, strict=True)
        ]

    def may_be_new(self, column: str) -> bool:
        """Whether a column may have a level that was not recorded: a group's, but no covariate's category."""
        return column in self.factors and not any(column in self.categories(q) for q in self.formulas)

    def beyond(self, condition: Condition) -> list[Coded]:
        """Numbers beyond those that were measured: the formula is then drawn out, and the element's law.

        As tables and this note print them: who asks for a velocity of 1.534 m/s means the 1.53414 measured.
        """
        notes = []
        for name, value in condition.items():
            if name in self.rows and self.is_number(name) and isinstance(value, float):
                low, stated, high = (
                    f"{x:.4g}" for x in (self.rows[name].min(), value, self.rows[name].max())
                )
                if not float(low) <= float(stated) <= float(high):
                    words = f"{name} beyond those measured, {low} to {high}"
                    notes.append(Coded(words, "beyond-measured"))
        return notes

    def average_notes(self, responses: Iterable[str], columns: Iterable[str]) -> list[Coded]:
        """That responses are averaged where these columns are given; empty where nothing is."""
        columns = tuple(columns)
        over = dict.fromkeys(name for q in responses for name in self.averaged(q, columns))
        if not over:
            return []
        return [Coded(f"averaged over {' and '.join(over)}, each level with equal weight", "averaged")]

    def averaged(self, response: str, columns: Iterable[str]) -> tuple[str, ...]:
        """The columns whose categories a response is averaged over where these columns are given."""
        columns = set(columns)
        known = columns.union(self.followers(*columns))
        formula = self.formulas.get(response, "1")
        within = [name for term in group_terms(formula) for name in self._within(term, formula, known)]
        return tuple(dict.fromkeys(n for n in (*self.categories(response), *within) if n not in known))

    @staticmethod
    def _within(term: GroupTerm, formula: str, known: Iterable[str]) -> tuple[str, ...]:
        """The factors of a term whose levels lie in given ones; none where the term's effect is typical."""
        left = tuple(factor for factor in term.factors if factor not in set(known))
        groups = {
            group_term.factors[0] for group_term in group_terms(formula) if len(group_term.factors) == 1
        } | {"subject"}
        return () if len(left) == len(term.factors) or groups & set(left) else left

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

    def at(
        self, response: str, conditions: Sequence[Condition]
    ) -> tuple[dict[str, np.ndarray], dict[GroupTerm, np.ndarray]]:
        """Covariates and those of the group terms in conditions that are complete, averaged, [condition]."""
        # Asked of the posterior and of the prior, and as part of other questions; to read a formula takes
        # longer than all draws of it.
        known = self._evaluated.setdefault(response, {})
        keys = [tuple(sorted(condition.items())) for condition in conditions]
        if missing := {key: c for key, c in zip(keys, conditions, strict=True) if key not in known}:
            covariates, groups = self._evaluate(response, list(missing.values()))
            for row, key in enumerate(missing):
                of_names = {name: values[row] for name, values in covariates.items()}
                known[key] = of_names, {term: values[row] for term, values in groups.items()}
        columns, of_groups = zip(*(known[key] for key in keys), strict=True)
        return (
            {name: np.array([at[name] for at in columns]) for name in columns[0]},
            {term: np.array([at[term] for at in of_groups]) for term in of_groups[0]},
        )

    def _evaluate(
        self, response: str, conditions: Sequence[Condition]
    ) -> tuple[dict[str, np.ndarray], dict[GroupTerm, np.ndarray]]:
        formula = self.formulas.get(response, "1")
        at = reference_row(self.rows, self.reference_mass_kg, categories_of_numbers(formula))
        spread = [self._spread(response, condition) for condition in conditions]
        new = pd.DataFrame([at | {k: c[k] for k in c if k in self.rows} for part in spread for c in part])
        for column in self.rows:
            new[column] = new[column].astype(float if self.is_number(str(column)) else str)
        covariates, groups = evaluated_at(formula, self.rows, self.reference_mass_kg, new)
        counts = np.array([len(part) for part in spread])
        first = np.cumsum(counts) - counts
        # A formula is linear in its columns, so that their mean is that of log q.
        return (
            {name: np.add.reduceat(values, first) / counts for name, values in covariates.items()},
            {term: np.add.reduceat(values, first) / counts for term, values in groups.items()},
        )

    def _spread(self, response: str, condition: Condition) -> list[dict[str, Any]]:
        """A condition in each combination of the categories that it does not give."""
        free = {
            name: self.rows[name].drop_duplicates().tolist()
            for name in self.categories(response)
            if name not in condition
        }
        return [dict(condition) | dict(zip(free, values, strict=True)) for values in product(*free.values())]

    def level_effects(
        self, response: str, term: GroupTerm, condition: Condition, levels: Sequence[str]
    ) -> Float[np.ndarray, " level"] | None:
        """The weights by which effects of a term's recorded levels enter a condition; None for a new level.

        All are 0 where the level is a typical one.
        """
        weights = np.zeros(len(levels))
        left = [factor for factor in term.factors if factor not in condition]
        if not left:
            labels = [_combined(term, condition)]
            if labels[0] not in levels:
                return None
        elif not self._within(term, self.formulas.get(response, "1"), condition):
            return weights
        elif set(left) <= set(self.categories(response)):
            labels = [_combined(term, part) for part in self._spread(response, condition)]
        else:
            rows = self.matching({name: condition[name] for name in term.factors if name not in left})
            labels = list(grouping_of(rows, term.factors).levels) if len(rows) else []
        places = {level: number for number, level in enumerate(levels)}
        for label in labels:
            if label in places:
                weights[places[label]] += 1 / len(labels)
        return weights

    @cached_property
    def _evaluated(self) -> dict[str, dict[Any, tuple[dict[str, float], dict[GroupTerm, float]]]]:
        return {}


def log_at_levels(
    draws: xr.Dataset,
    recorded: Recorded,
    response: str,
    conditions: Sequence[Condition],
    *,
    new_levels: int | None = None,
) -> Float[np.ndarray, "chain draw condition"]:
    """The expected log of a response in each condition, for each draw.

    Args:
        draws: the group posterior or prior.
        recorded: what was measured.
        response: "K", "C" or a further parameter of the element.
        conditions: what is given in each, by column: a category or the name of a level as text, or a number.
            A level of a group that was not measured, alone or in its combination, is a new one of the same
            population: its effect is drawn from N(0, s²), the same wherever it stands.
        new_levels: None for typical levels of groups that are not given; a number for new ones, which is also
            the seed of all new levels' effects.
    """
    complete = [recorded.completed(condition) for condition in conditions]
    covariates, groups = recorded.at(response, complete)
    log_response = draws[intercept(parameter_of(response))].to_numpy()[..., None] + np.zeros(len(conditions))
    for name, values in covariates.items():
        log_response = log_response + _coefficient(draws, name, response)[..., None] * values
    for term, values in groups.items():
        log_response = log_response + _effects(draws, recorded, term, response, complete, new_levels) * values
    return log_response


def _effects(
    draws: xr.Dataset,
    recorded: Recorded,
    term: GroupTerm,
    response: str,
    conditions: Sequence[Condition],
    new_levels: int | None,
) -> Float[np.ndarray, "chain draw condition"]:
    """What the levels of a term add to the intercept or to a coefficient."""
    term_effects = draws[(term.coefficient if term.slope else term.effect)(response)]
    values = term_effects.to_numpy()
    if term.slope:
        values = values - _coefficient(draws, term.slope, response)[..., None]
    levels = term_effects[term.grouping].astype(str).to_numpy().tolist()
    weights = np.zeros((len(levels), len(conditions)))
    drawn = {}
    for number, condition in enumerate(conditions):
        level_weights = recorded.level_effects(response, term, condition, levels)
        if level_weights is not None:
            weights[:, number] = level_weights
        if level_weights is None or (new_levels is not None and not level_weights.any()):
            seed = [new_levels or 0, crc32(f"{term} {response} {_combined(term, condition)}".encode())]
            sd = draws[term.sd(response)].to_numpy()
            drawn[number] = sd * np.random.default_rng(seed).standard_normal(sd.shape)
    effects = values @ weights
    for number, effect in drawn.items():
        effects[..., number] = effect
    return effects


def _coefficient(draws: xr.Dataset, name: str, response: str) -> np.ndarray:
    """The population's coefficient of a covariate; 0 where the formula has levels' own alone."""
    variable = common_coefficient(name, response)
    if variable in draws:
        return draws[variable].to_numpy()
    return np.zeros((draws.sizes["chain"], draws.sizes["draw"]))


def _combined(term: GroupTerm, condition: Condition) -> str:
    return ":".join(label_of(condition.get(factor, "")) for factor in term.factors)


def label_of(value: Any) -> str:
    """A value as levels are called, see `bayestissue.hierarchy.formulas.group_terms.labels_of`."""
    return f"{value:.12g}" if isinstance(value, float) else str(value)
