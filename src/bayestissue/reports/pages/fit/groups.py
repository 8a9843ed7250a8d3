"""People, conditions and other groups: their levels, their own coefficients, and the mass of the impactor."""

from __future__ import annotations

from typing import NamedTuple

from bayestissue.model.hierarchy.formulas.group_terms import stem_of
from bayestissue.reports.pages.fit.fit_run import FitRun
from bayestissue.reports.pages.posterior import without_zero

_FIRST = ("subject", "trial")


class OwnSlope(NamedTuple):
    """A coefficient that differs between the levels of a grouping.

    Attributes:
        grouping: the dimension of its levels, such as ``subject``.
        covariate: empty of a mass exponent.
        quantity: K, C, or a further parameter that has a formula.
    """

    grouping: str
    covariate: str
    quantity: str

    @property
    def name(self) -> str:
        """The name of each level's own coefficient in the posterior."""
        return f"{stem_of(self.grouping)}_{self.shared}"

    @property
    def shared(self) -> str:
        """The name of the population's coefficient."""
        what = f"effect_of_{self.covariate}" if self.covariate else "mass_exponent"
        return f"{what}_{self.quantity}"

    @property
    def words(self) -> str:
        """What it is."""
        if self.covariate:
            return f"effect of {self.covariate} on log {self.quantity}"
        return f"mass exponent of {self.quantity}"


def ranked(run: FitRun) -> dict[str, list[str]]:
    """What the levels of each grouping have in the posterior, K, C or others: people, then conditions."""
    levels = {}
    for level in dict.fromkeys((*_FIRST, *groupings(run))):
        with_effects = [q for q in run.responses if run.has(f"{stem_of(level)}_effect_{q}")]
        if quantities := [q for q in with_effects if run.of_levels(q, level)]:
            levels[level] = quantities
    return levels


def groupings(run: FitRun) -> list[str]:
    """The dimensions whose levels have effects: people and conditions, then the others."""
    of_effects = [
        str(array.dims[-1])
        for name, array in run.groups["posterior"].data_vars.items()
        if str(name).endswith(tuple(f"_effect_{q}" for q in run.responses)) and array.ndim > 2
    ]
    return list(dict.fromkeys([*(grouping for grouping in _FIRST if grouping in of_effects), *of_effects]))


def own_slopes(run: FitRun) -> list[OwnSlope]:
    """The coefficients that differ between levels."""
    slopes = []
    for variable, array in run.groups["posterior"].data_vars.items():
        name, dimension = str(variable), str(array.dims[-1])
        start = f"{stem_of(dimension)}_"
        if array.ndim != 3 or not name.startswith(start):
            continue
        for quantity in run.of_tissue:
            what = name.removeprefix(start).removesuffix(f"_{quantity}")
            if f"{start}{what}" != name and (what == "mass_exponent" or what.startswith("effect_of_")):
                covariate = "" if what == "mass_exponent" else what.removeprefix("effect_of_")
                slopes.append(OwnSlope(dimension, covariate, quantity))
    return slopes


def apart(run: FitRun, slope: OwnSlope) -> list[str]:
    """The levels whose coefficient a 90 % interval tells from the population's."""
    slopes = run.draws(slope.name)
    deviations = slopes - run.draws(slope.shared)[:, None] if run.has(slope.shared) else slopes
    return without_zero(deviations, run.labels(slope.grouping))
