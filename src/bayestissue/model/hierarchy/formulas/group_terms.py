"""Group terms of a formula, such as ``(1|subject:side)``: their names, and the levels that they have.

A group term gives each level l of a grouping an effect of its own, b_l ~ N(0, s²) with s unknown: on the
intercept, or on the coefficient of a covariate x, so that row i has x_i b_l(i) more. The coefficient and the
intercept of the same level are independent of each other, each with a standard deviation of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Int

MASS_TERM = "log(mass_kg)"


@dataclass(frozen=True)
class GroupTerm:
    """Effects of each level of a grouping.

    Attributes:
        factors: columns whose combinations are the levels: ``("subject", "side")`` of ``(1|subject:side)``.
        slope: the covariate whose coefficient differs between levels; empty where the intercept does.
    """

    factors: tuple[str, ...]
    slope: str = ""

    def __str__(self) -> str:
        """As a formula has it."""
        return f"({self.slope or 1}|{quoted(self.factors)})"

    @property
    def grouping(self) -> str:
        """The name of the levels' dimension, such as ``subject:side``."""
        return ":".join(self.factors)

    @property
    def stem(self) -> str:
        """What its quantities are named by: ``subject_side``, ``subject_mass_exponent``."""
        levels = stem_of(self.grouping)
        if not self.slope:
            return levels
        return f"{levels}_{_coefficient(self.slope)}"

    def sd(self, response: str) -> str:
        """The name of the standard deviation of the effects on log K or log C."""
        return f"sd_{self.stem}_{response}"

    def effect(self, response: str) -> str:
        """The name of the effects themselves, all about 0."""
        return f"{self.stem}_{'deviation' if self.slope else 'effect'}_{response}"

    def coefficient(self, response: str) -> str:
        """The name of each level's own coefficient: the population's and the level's deviation together."""
        return f"{self.stem}_{response}"

    def variable(self, response: str) -> str:
        """The name of what draws hold of each level: its own coefficient, or its effect on the intercept."""
        return self.coefficient(response) if self.slope else self.effect(response)


SUBJECT, TRIAL = GroupTerm(("subject",)), GroupTerm(("trial",))


def common_coefficient(covariate: str, response: str) -> str:
    """The name of the population's coefficient of a covariate."""
    return f"{_coefficient(covariate)}_{response}"


def _coefficient(covariate: str) -> str:
    """By its column, such as ``effect_of_side[left]``: files have no names with / in them."""
    return "mass_exponent" if covariate == MASS_TERM else f"effect_of_{as_name(covariate).replace('`', '')}"


def as_name(text: str) -> str:
    """A text as part of a variable's name, in which a / would be a path: it becomes a division slash."""
    return text.replace("/", "\N{DIVISION SLASH}")


def stem_of(grouping: str) -> str:
    """What quantities of a grouping's levels are named by: ``subject_side`` of ``subject:side``."""
    return as_name(grouping.replace(":", "_"))


def quoted(factors: Iterable[str]) -> str:
    """Columns joined as a formula reads them."""
    return ":".join(name if name.isidentifier() else f"`{name}`" for name in factors)


def written(terms: Sequence[GroupTerm]) -> list[str]:
    """Terms as a formula has them, those of one grouping together: ``(log(mass_kg)|subject)``."""
    parts = []
    for factors in dict.fromkeys(term.factors for term in terms):
        slopes = [term.slope for term in terms if term.factors == factors]
        without = "" if "" in slopes else "0 + "
        parts.append(f"({without}{' + '.join(filter(None, slopes)) or 1}|{quoted(factors)})")
    return parts


@dataclass(frozen=True)
class Grouping:
    """The levels of a column, or of the combinations of several, and the level of each row.

    Attributes:
        factors: the columns.
        levels: their labels in order of appearance, such as ``s01:left``.
        code: the number of each row's level.
    """

    factors: tuple[str, ...]
    levels: tuple[str, ...]
    code: Int[np.ndarray, " row"]

    @property
    def name(self) -> str:
        """The name of the levels' dimension, such as ``subject:side``."""
        return ":".join(self.factors)


def grouping_of(rows: pd.DataFrame, factors: tuple[str, ...]) -> Grouping:
    """The levels of ``factors`` in a table that has no missing value in them."""
    labels = [labels_of(rows[name]) for name in factors]
    codes = np.stack([pd.factorize(level)[0] for level in labels])
    together = np.unique(codes, axis=1, return_inverse=True)[1].reshape(-1)
    code = pd.factorize(together)[0]
    first = np.unique(code, return_index=True)[1]
    return Grouping(factors, tuple(":".join(level[row] for level in labels) for row in first), code)


def labels_of(column: pd.Series) -> np.ndarray:
    """A column's values as levels are called."""
    if pd.api.types.is_float_dtype(column):
        return np.array([f"{value:.12g}" for value in column], dtype=object)
    return column.astype(str).to_numpy(object)
