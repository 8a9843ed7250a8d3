"""Whether standardised errors of impacts are credible together, with a known rate of false alarms.

Under the right model each z is standard normal and independent of the others. Four kinds of departure are
looked for, each with the same share of the whole rate, by Bonferroni's inequality: a mean of all impacts
away from 0, one of a group (all impacts of a person, or of a condition), a single impact far out, and a sum
of squares too great for chi-square. A mean is to be `LEAST_SHIFT` at least and a root mean square
`LEAST_SPREAD`: where impacts are many, less of either is sure too, but does little to intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2, norm

from bayestissue.base.arrays import IndexPerImpact, MaskPerImpact, PerImpact

# Of false alarms, over everything that is looked at.
RATE = 0.005
# An interval that rests on nothing but a normal error holds 86 % where that error's mean is half its standard
# deviation off, and 75 % where it is half as wide again as declared.
LEAST_SHIFT = 0.5
LEAST_SPREAD = 1.5
ALL, IMPACT = "all", "impact"

Groups = Mapping[str, IndexPerImpact]


@dataclass(frozen=True)
class Alarms:
    """What is incredible of a set of z.

    Attributes:
        together: their mean.
        groups: by kind of group, the mean of each of its groups.
        single: each by itself.
        scatter: their sum of squares.
    """

    together: bool
    groups: dict[str, Bool[np.ndarray, " group"]]
    single: MaskPerImpact
    scatter: bool

    @property
    def any(self) -> bool:
        """Whether anything is."""
        grouped = any(flagged.any() for flagged in self.groups.values())
        return bool(self.together or grouped or self.single.any() or self.scatter)


def alarms(z: PerImpact, groups: Groups, rate: float = RATE) -> Alarms:
    """Which departures of ``z`` from independent standard normals are incredible.

    Args:
        z: standardised errors.
        groups: by kind ("subject", "trial"), the number of each impact's group, from 0.
        rate: at most this share of right models raises any alarm.
    """
    share = rate / (3 + len(groups))
    count = len(z)
    return Alarms(
        together=bool(_shifted(np.array([z.mean()]), np.array([count]), share)[0]),
        groups={kind: _of_groups(z, codes, share) for kind, codes in groups.items()},
        single=np.abs(z) > norm.isf(share / (2 * count)),
        scatter=bool((z**2).sum() > max(chi2.isf(share, count), LEAST_SPREAD**2 * count)),
    )


def _of_groups(z: PerImpact, codes: IndexPerImpact, rate: float) -> Bool[np.ndarray, " group"]:
    size = np.bincount(codes)
    mean = np.bincount(codes, weights=z) / np.maximum(size, 1)
    # One group is all impacts, and a group of one impact that impact.
    return _shifted(mean, size, rate) & (size > 1) & (len(size) > 1)


def _shifted(
    mean: Float[np.ndarray, " group"], size: Int[np.ndarray, " group"], rate: float
) -> Bool[np.ndarray, " group"]:
    limit = norm.isf(rate / (2 * len(mean))) / np.sqrt(np.maximum(size, 1))
    return np.abs(mean) > np.maximum(limit, LEAST_SHIFT)


@dataclass(frozen=True)
class ErrorPattern:
    """The simplest account of incredible errors.

    Attributes:
        kind: `ALL`, a kind of group, or `IMPACT`.
        impacts: which are concerned.
        common: whether those of a group (or all of them) share one factor.
    """

    kind: str
    impacts: MaskPerImpact
    common: bool


def pattern_of(
    error: PerImpact, sd: PerImpact, unit: PerImpact, groups: Groups, rate: float = RATE
) -> ErrorPattern | None:
    """What impacts' errors have in common, if they are incredible: None if they are not.

    One factor of all impacts is the simplest, then one of each of some groups, which after it is taken off
    leaves nothing incredible; then single impacts.

    Args:
        error: of each impact.
        sd: what its standard deviation would be under the right model.
        unit: what a common factor multiplies, such as the velocity.
        groups: as of `alarms`.
        rate: as of `alarms`.
    """
    alarmed = alarms(error / sd, groups, rate)
    if not alarmed.any:
        return None
    flagged = {ALL: np.array([True]), **alarmed.groups}
    codes_of = {ALL: np.zeros(len(error), int), **groups}
    for kind, chosen in flagged.items():
        codes = codes_of[kind]
        weight = np.bincount(codes, weights=unit**2 / sd**2)
        factor = np.bincount(codes, weights=error * unit / sd**2) / np.maximum(weight, 1e-300)
        concerned = chosen[codes]
        left = error - np.where(concerned, factor[codes] * unit, 0.0)
        if concerned.any() and not alarms(left / sd, groups, rate).any:
            return ErrorPattern(kind, concerned, common=True)
    if alarmed.single.any():
        return ErrorPattern(IMPACT, alarmed.single, common=False)
    return ErrorPattern(ALL, np.ones(len(error), bool), common=False)
