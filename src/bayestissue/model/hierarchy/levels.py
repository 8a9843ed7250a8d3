"""K, C or a further parameter at given levels: of a person, a side, a covariate, a new level of a group.

With the formula's covariates x and group terms z b, the expected log of a response is

    log q = intercept + exponent log(M / M_ref) + sum_k effect_k x_k + sum_g z_g b_g(level),

and q itself the median of impacts there. What is not given is

- at the reference: the reference mass, the mean of other numbers;
- averaged: log q over the recorded categories of a covariate, such as sides, each with equal weight; and the
  effects of levels that lie in a given one, such as a person's own sides;
- typical: an effect of 0 of a group's level, such as of a person or a session.

But what follows from a given level (see `bayestissue.model.hierarchy.recorded`) has that level's value. There
is no other way to a value: variables such as K_subject are `DesignAt.log`, and so is all that is asked of a
fit (`bayestissue.inference.answers.study`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.impact_arrays import PerDraw
from bayestissue.model.hierarchy.formulas.formula import categories_of_numbers, reference_row
from bayestissue.model.hierarchy.formulas.group_terms import GroupTerm, common_coefficient, grouping_of
from bayestissue.model.hierarchy.recorded import Condition, Recorded, ResponseFormula, label_of
from bayestissue.model.hierarchy.responses import intercept, parameter_of

# What questions and tables call a level that was not measured.
NEW = "new"


@dataclass(frozen=True, eq=False)
class DesignAt:
    """The design of a response in some conditions: log q = intercept + X beta + sum over terms of z Z b.

    Attributes:
        response: "K", "C" or a further parameter of the element.
        conditions: with what follows from them.
        covariates: X, by its columns.
        multipliers: z of each group term: 1 for an intercept.
        levels: Z of each group term: the levels whose effects each condition has the mean of, none where it
            has a typical level's.
    """

    response: str
    conditions: Sequence[Condition]
    covariates: Mapping[str, Float[np.ndarray, " condition"]]
    multipliers: Mapping[GroupTerm, Float[np.ndarray, " condition"]]
    levels: Mapping[GroupTerm, Sequence[Sequence[str]]]

    def log(
        self, draws: xr.Dataset, new_levels: int | None = None
    ) -> Float[np.ndarray, "chain draw condition"]:
        """The expected log of the response, for each draw.

        Args:
            draws: the group posterior or prior.
            new_levels: None for typical levels of groups that are not given; a number for new ones, which is
                also the seed of all new levels' effects.
        """
        parameter, none = parameter_of(self.response), np.zeros(len(self.conditions))
        log = draws[intercept(parameter)].to_numpy()[..., None] + none
        for name, x in self.covariates.items():
            log = log + self._coefficient(draws, name)[..., None] * x
        for term, z in self.multipliers.items():
            log = log + self._effects(draws, term, new_levels) * z
        return log

    def _coefficient(self, draws: xr.Dataset, covariate: str) -> PerDraw:
        """The population's coefficient of a covariate; 0 where the formula has levels' own alone."""
        variable = common_coefficient(covariate, self.response)
        if variable in draws:
            return draws[variable].to_numpy()
        return np.zeros((draws.sizes["chain"], draws.sizes["draw"]))

    def _effects(
        self, draws: xr.Dataset, term: GroupTerm, new_levels: int | None
    ) -> Float[np.ndarray, "chain draw condition"]:
        """Z b: what the levels of a term add to the intercept or to a coefficient."""
        of_levels = draws[term.variable(self.response)]
        b = of_levels.to_numpy()
        if term.slope:
            b = b - self._coefficient(draws, term.slope)[..., None]
        row = {level: number for number, level in enumerate(of_levels[term.grouping].astype(str).to_numpy())}
        Z = np.zeros((len(row), len(self.conditions)))
        for column, levels in enumerate(self.levels[term]):
            for level in row.keys() & set(levels):
                Z[row[level], column] = levels.count(level) / len(levels)
        effects = b @ Z
        for column, condition in enumerate(self.conditions):
            is_given = condition.keys() >= set(term.factors)
            if not Z[:, column].any() and (is_given or new_levels is not None):
                name = f"{term} {self.response} {_level(term, condition)}"
                rng = np.random.default_rng([new_levels or 0, crc32(name.encode())])
                sd = draws[term.sd(self.response)].to_numpy()
                effects[..., column] = sd * rng.standard_normal(sd.shape)
        return effects


def design_at(recorded: Recorded, response: str, conditions: Sequence[Condition]) -> DesignAt:
    """The design of a response in some conditions.

    Args:
        recorded: what was measured, and the formulas.
        response: "K", "C" or a further parameter of the element.
        conditions: what is given in each, by column: a category or the name of a level as text, or a number.
            A level of a group that was not measured, alone or in its combination, is a new one of the same
            population: its effect is drawn from N(0, s²), the same wherever it stands.
    """
    formula = recorded.response(response)
    complete = [recorded.completed(condition) for condition in conditions]
    averaged = [formula.spread(condition) for condition in complete]
    coded = categories_of_numbers(formula.formula)
    reference = reference_row(recorded.rows, recorded.reference_mass_kg, coded)
    rows = pd.DataFrame(
        [reference | {k: at[k] for k in at if k in reference} for part in averaged for at in part]
    )
    for column in map(str, recorded.rows):
        rows[column] = rows[column].astype(float if recorded.is_number(column) else str)
    counts = np.array([len(part) for part in averaged])
    first = np.cumsum(counts) - counts
    columns, of_groups = formula.at(rows)

    def mean(values: Float[np.ndarray, " row"]) -> Float[np.ndarray, " condition"]:
        """A formula is linear in its columns, so that their mean is that of log q."""
        return np.add.reduceat(values, first) / counts

    covariates = {name: mean(values) for name, values in columns.items()}
    multipliers = {term: mean(values) for term, values in of_groups.items()}
    levels = {
        term: [_levels(formula, term, *pair) for pair in zip(complete, averaged, strict=True)]
        for term in multipliers
    }
    return DesignAt(response, complete, covariates, multipliers, levels)


def _levels(
    formula: ResponseFormula, term: GroupTerm, condition: Condition, averaged: Sequence[Condition]
) -> list[str]:
    """The levels of a term in a condition, which is averaged over some categories: see `DesignAt`."""
    known = {name: condition[name] for name in term.factors if name in condition}
    left = set(term.factors) - known.keys()
    if not left:
        return [_level(term, condition)]
    if not formula.within(term, known):
        return []
    if left <= set(formula.categories):
        return [_level(term, part) for part in averaged]
    rows = formula.recorded.rows[formula.recorded.matching(known)]
    return list(grouping_of(rows, term.factors).levels) if len(rows) else []


def _level(term: GroupTerm, condition: Condition) -> str:
    return ":".join(label_of(condition.get(factor, "")) for factor in term.factors)
