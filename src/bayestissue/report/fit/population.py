"""People, conditions and other groups: their levels, their own coefficients, and the mass of the impactor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bayestissue.hierarchy.formulas.group_terms import stem_of
from bayestissue.report.fit.run import FitRun
from bayestissue.report.posterior import Spread, group_words, spread
from bayestissue.report.wording import listed

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
        what = f"effect_of_{self.covariate}" if self.covariate else "mass_exponent"
        return f"{stem_of(self.grouping)}_{what}_{self.quantity}"

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
        for quantity in run.responses:
            what = name.removeprefix(start).removesuffix(f"_{quantity}")
            if f"{start}{what}" != name and (what == "mass_exponent" or what.startswith("effect_of_")):
                covariate = "" if what == "mass_exponent" else what.removeprefix("effect_of_")
                slopes.append(OwnSlope(dimension, covariate, quantity))
    return slopes


def differing_words(run: FitRun) -> str:
    """Whether people, or the levels of another grouping, differ in the dependence on mass; else empty."""
    return " ".join(_differing(run, slope) for slope in own_slopes(run) if not slope.covariate)


def _differing(run: FitRun, slope: OwnSlope) -> str:
    scatter = spread(run.draws(f"sd_{slope.name}"))
    low, high = np.percentile(_deviations(run, slope), [5, 95], axis=0)
    apart = int(((low > 0) | (high < 0)).sum())
    one, several = group_words(slope.grouping)
    which = f"{apart} of {low.size} {several}" if apart else f"no {one}"
    verb = "are" if apart > 1 else "is"
    begin = (
        f"{several.capitalize()} differ in it"
        if apart
        else f"{several.capitalize()} are not seen to differ in it"
    )
    return (
        f"{begin}: in {slope.quantity} {which} {verb} told apart from the common exponent by 90 % intervals; "
        f"standard deviation of the exponents {scatter.value} ({scatter.range})."
    )


def _deviations(run: FitRun, slope: OwnSlope) -> np.ndarray:
    slopes = run.draws(slope.name)
    return slopes - run.draws(slope.shared)[:, None] if run.has(slope.shared) else slopes


def slope_words(run: FitRun, slope: OwnSlope) -> str:
    """Which levels' coefficients are told from the population's."""
    low, high = np.percentile(_deviations(run, slope), [5, 95], axis=0)
    apart = np.array(run.labels(slope.grouping))[(low > 0) | (high < 0)]
    scatter: Spread = spread(run.draws(f"sd_{slope.name}"))
    named = f": {listed([str(label) for label in apart])}" if apart.size else ""
    one, _ = group_words(slope.grouping)
    return (
        f"The {slope.words} differs between one {one} and the next with a standard deviation of "
        f"{scatter.value} ({scatter.range}). A 90 % interval tells {apart.size or 'none'} of {low.size} from "
        f"the typical one{named}."
    )
