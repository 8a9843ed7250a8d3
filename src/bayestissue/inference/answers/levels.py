"""K, C or a further parameter at given levels: of a person, a side, a covariate, a new level of a group.

With the formula's covariates x and group terms z b, the expected log of a response is

    log q = intercept + exponent log(M / M_ref) + sum_k effect_k x_k + sum_g z_g b_g(level),

and q itself the median of impacts there. What is not given is at the reference: the reference mass, the mean
of other numbers, the first recorded impact's category, effects of groups 0 (a typical level). But a column
that is the same in all impacts of each level of a given one, as a person's sex is, has that level's value;
mass, velocity and trial, which are chosen and no property of a level, never follow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.dataset.impacts import RESERVED
from bayestissue.hierarchy.effects import intercept, parameter_of
from bayestissue.hierarchy.formulas.formula import (
    categories_of_numbers,
    columns_named,
    evaluated_at,
    group_terms,
    reference_row,
)
from bayestissue.hierarchy.formulas.group_terms import MASS_TERM, GroupTerm, labels_of

Condition = Mapping[str, str | float]
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
        """Of a dataset's table of impacts."""
        kept = ["subject", "trial", "mass_kg", "velocity_m_s"]
        rows = impacts[[name for name in impacts if name in kept or name not in RESERVED]]
        return cls(rows.reset_index(drop=True), formulas, reference_mass_kg)

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """The columns that the formulas are of."""
        return tuple(dict.fromkeys(name for each in self.formulas.values() for name in columns_named(each)))

    @cached_property
    def lacking(self) -> tuple[str, ...]:
        """Columns of the formulas that an earlier version of the program did not keep."""
        return tuple(name for name in self.needed if name not in self.rows)

    @cached_property
    def reference(self) -> dict[str, Any]:
        """The reference row: see `bayestissue.hierarchy.formulas.formula.reference_row`."""
        return reference_row(self.rows, self.reference_mass_kg)

    @cached_property
    def _categories_of_numbers(self) -> frozenset[str]:
        return frozenset().union(*map(categories_of_numbers, self.formulas.values()))

    def is_category(self, column: str) -> bool:
        """Whether a column's values are categories: text, or numbers that a formula has in ``C()``."""
        return column in self._categories_of_numbers or not self.is_number(column)

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
            keep &= labels_of(self.rows[column]) == _label(value)
        return self.rows[keep]

    def completed(self, condition: Condition) -> dict[str, Any]:
        """The condition with the columns that follow from it: see the module."""
        found = dict(condition)
        for given, value in condition.items():
            rows = self.matching({given: value}) if self.followers(given) else self.rows[:0]
            if len(rows):
                found = {name: rows[name].iloc[0] for name in self.followers(given)} | found
        return found

    def followers(self, column: str) -> tuple[str, ...]:
        """The columns that follow from one of categories or levels; none from a number."""
        return self._followers.get(column, ())

    @cached_property
    def named(self) -> tuple[str, ...]:
        """The columns whose values are names: categories, and what formulas group by."""
        factors = {
            factor for each in self.formulas.values() for term in group_terms(each) for factor in term.factors
        }
        return tuple(str(name) for name in self.rows if name in factors or self.is_category(str(name)))

    @cached_property
    def _followers(self) -> dict[str, tuple[str, ...]]:
        others = [str(name) for name in self.rows if name not in _CHOSEN]
        labels = {given: labels_of(self.rows[given]) for given in self.named}
        return {
            given: tuple(
                name
                for name in others
                if name != given and self.rows[name].groupby(by).nunique(dropna=False).eq(1).all()
            )
            for given, by in labels.items()
        }

    def at(
        self, response: str, conditions: Sequence[Condition]
    ) -> tuple[dict[str, np.ndarray], dict[GroupTerm, np.ndarray]]:
        """Covariates and those of the group terms in conditions that are complete, [condition]."""
        key = response, tuple(tuple(sorted(condition.items())) for condition in conditions)
        if key not in self._evaluated:
            # Asked of the posterior and of the prior; to read a formula takes longer than all draws of it.
            formula = self.formulas.get(response, "1")
            at = reference_row(self.rows, self.reference_mass_kg, categories_of_numbers(formula))
            new = pd.DataFrame([at | {k: c[k] for k in c if k in self.rows} for c in conditions])
            for column in self.rows:
                new[column] = new[column].astype(float if self.is_number(str(column)) else str)
            self._evaluated[key] = evaluated_at(formula, self.rows, self.reference_mass_kg, new)
        return self._evaluated[key]

    @cached_property
    def _evaluated(self) -> dict[Any, tuple[dict[str, np.ndarray], dict[GroupTerm, np.ndarray]]]:
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
    complete = [recorded.completed(each) for each in conditions]
    covariates, groups = recorded.at(response, complete)
    found = draws[intercept(parameter_of(response))].to_numpy()[..., None] + np.zeros(len(conditions))
    for name, values in covariates.items():
        found = found + _coefficient(draws, name, response)[..., None] * values
    for term, values in groups.items():
        for place, condition in enumerate(complete):
            effect = _effect(draws, term, response, condition, new_levels)
            if values[place] and effect is not None:
                found[..., place] += effect * values[place]
    return found


def _coefficient(draws: xr.Dataset, name: str, response: str) -> np.ndarray:
    """The population's coefficient of a covariate; 0 where the formula has levels' own alone."""
    variable = f"mass_exponent_{response}" if name == MASS_TERM else f"effect_of_{name}_{response}"
    if variable in draws:
        return draws[variable].to_numpy()
    return np.zeros((draws.sizes["chain"], draws.sizes["draw"]))


def _effect(
    draws: xr.Dataset, term: GroupTerm, response: str, condition: Condition, new_levels: int | None
) -> np.ndarray | None:
    """What a level adds to the intercept or to a coefficient, [chain, draw]; None for a typical level."""
    given = [condition.get(factor) for factor in term.factors]
    if any(value is None for value in given) and new_levels is None:
        return None
    label = ":".join("" if value is None else _label(value) for value in given)
    own = draws[(term.own if term.slope else term.effect)(response)]
    if label in own[term.grouping].astype(str).to_numpy():
        effect = own.sel({term.grouping: label}).to_numpy()
        return effect - _coefficient(draws, term.slope, response) if term.slope else effect
    sd = draws[term.sd(response)].to_numpy()
    seed = [new_levels or 0, crc32(f"{term} {response} {label}".encode())]
    return sd * np.random.default_rng(seed).standard_normal(sd.shape)


def _label(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)
