"""Reliability: how repeatable a measured K or C of a person is, and what makes it differ.

One measurement of a person, by one trace alone, has at the reference mass and equal covariates

    log q = mu + p + c + d + i + m,

all of them independent and normal, with the variances

    P  of people, and of groups that people belong to whole, such as teams,
    S  of an error of the mass that all impacts of a person share,
    A  of conditions, and of other groups that several people went through, such as sessions,
    D  of groups within a person, such as a person's sides,
    I  of impacts, the same person in the same condition: what the person does,
    M  of what one trace leaves unknown of its impact: what the measuring chain and noise do.

P, A, D and I are unknowns of the fit, each draw of which gives one value of everything below. M is given: the
median over impacts of the Laplace variance of log q given its trace alone (``measurement_sd``). Noise in a
trace is no scatter between impacts, so the fit's I is without it, and a measured value has both.

By the names of McGraw and Wong (1996, doi:10.1037/1082-989X.1.1.30), with E = D + I + M (their error; with
one impact of each person in each condition it holds their interaction too), k impacts of a person, and in
them k_a and k_d levels of such a group:

    ICC(C,1) = P / (P + S + E)          ICC(C,k) = P / (P + S + D/k_d + (I + M)/k)
    ICC(A,1) = P / (P + S + A + E)      ICC(A,k) = P / (P + S + A/k_a + D/k_d + (I + M)/k)

C, consistency, lets conditions move everybody alike; A, absolute agreement, counts that as error. With one
impact of each person in each of k conditions k_a = k, as they have it. With an S of 0 and a formula without
conditions both are their one-way ICC(1) and ICC(k). S counts as error, and repeats don't lessen it.

The standard error of measurement is s = (A + E)^1/2 for agreement and E^1/2 for consistency on the log scale:
in percent exp(s) - 1, in units that share of a typical person's K or C. The minimal detectable change between
two measurements of a person is exp(1.96 2^1/2 s) - 1 (Weir 2005, doi:10.1519/15184.1); S, in both alike, is
none of it. By Spearman and Brown's formula an ICC of R needs

    k = R E / (P (1 - R) - R S)         (with A + E for agreement)

repeats, each in a condition of its own; where S leaves less than R, no number of them is enough.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.hierarchy.effects import intercept, parameter_of, sd_impact
from bayestissue.hierarchy.formulas.formula import group_terms
from bayestissue.hierarchy.formulas.group_terms import SUBJECT, TRIAL, GroupTerm, grouping_of
from bayestissue.inference.answers.levels import Recorded

COLUMNS = ["quantity", "measure", "form", "median", "low", "high", "unit"]
ICC, SEM, MDC = "intraclass correlation", "standard error of measurement", "minimal detectable change (95 %)"
REPEATS = "repeats"
TARGETS = (0.75, 0.9)
# Of a normal's middle 95 %, for the difference of two measurements.
_DETECTABLE = 1.96 * np.sqrt(2)
_UNITS = {"K": "N/m", "C": "N s/m"}
_PERCENT = "%"

Drawn = Float[np.ndarray, "*draw"]


class Variances(NamedTuple):
    """Variances of log q: see the module; ``agreement`` and ``within`` with the levels in k impacts, each."""

    people: Drawn
    shared: float
    agreement: Sequence[tuple[Drawn, float]]
    within: Sequence[tuple[Drawn, float]]
    impacts: Drawn
    measurement: float
    k: float

    def error(self, *, agreement: bool, averaged: bool = False) -> Drawn:
        """Variance of one measurement, or of the mean of a person's, about the person's own value."""
        groups = [*self.within, *(self.agreement if agreement else ())]
        of_groups = [variance / (levels if averaged else 1) for variance, levels in groups]
        return np.sum(of_groups, axis=0) + (self.impacts + self.measurement) / (self.k if averaged else 1)

    def icc(self, *, agreement: bool, averaged: bool) -> Drawn:
        """The intraclass correlation: squared correlation of what is measured and the person's own value."""
        error = self.error(agreement=agreement, averaged=averaged)
        return self.people / (self.people + self.shared + error)

    def repeats(self, target: float, *, agreement: bool) -> Drawn:
        """How many measurements have a mean of this ICC; a fraction, and infinite where none have."""
        left = self.people * (1 - target) - target * self.shared
        with np.errstate(divide="ignore"):
            return np.where(left > 0, target * self.error(agreement=agreement) / np.maximum(left, 0), np.inf)


def variances(
    draws: xr.Dataset, recorded: Recorded, response: str, *, measurement_sd: float, shared_sd: float = 0.0
) -> Variances:
    """Those of one response; ``people`` are 0 where the formula has no effect of the person."""
    zero = np.zeros((draws.sizes["chain"], draws.sizes["draw"]))
    people = zero
    agreement: list[tuple[np.ndarray, float]] = []
    within: list[tuple[np.ndarray, float]] = []
    for term in group_terms(recorded.formulas.get(response, "1")):
        if term.slope:
            continue
        variance = draws[term.sd(response)].to_numpy() ** 2
        levels, kind = _place(recorded, term)
        if kind == "people":
            people = people + variance
        else:
            (agreement if kind == "agreement" else within).append((variance, levels))
    impacts = draws[sd_impact(parameter_of(response))].to_numpy() ** 2
    each = recorded.rows.groupby("subject").size().median()
    return Variances(people, shared_sd**2, agreement, within, impacts, measurement_sd**2, float(each))


def _place(recorded: Recorded, term: GroupTerm) -> tuple[float, str]:
    """Levels of a grouping that a person went through (median), and which variance it is part of."""
    code = grouping_of(recorded.rows, term.factors).code
    pairs = pd.DataFrame({"level": code, "person": recorded.rows["subject"]}).drop_duplicates()
    of_person, of_level = pairs.groupby("person").size(), pairs.groupby("level").size()
    levels = float(of_person.median())
    if term == SUBJECT or (term != TRIAL and of_person.max() == 1):
        return levels, "people"
    return levels, "within" if of_level.max() == 1 else "agreement"


def reliability(found: Mapping[str, Variances], draws: xr.Dataset) -> tuple[pd.DataFrame, xr.Dataset]:
    """Every coefficient, as a table and as variables of the posterior.

    Args:
        found: variances of each response.
        draws: the group posterior.

    Returns:
        `COLUMNS`, with the median and the 90 % equal-tailed interval; repeats are whole numbers, at least 1.
        The variables have one of each draw, but for what is the same in all; repeats are fractions, and left
        out where no number of them is enough in some draw.
    """
    rows: list[tuple[Any, ...]] = []
    variables: dict[str, xr.Variable] = {}

    def told(q: str, measure: str, form: str, values: Drawn, unit: str, name: str = "") -> None:
        rows.append((q, measure, form, *np.quantile(values, [0.5, 0.05, 0.95], method="higher"), unit))
        if name and np.isfinite(values).all() and np.ptp(values) > 0:
            words = f"{measure}, {form}, of {q}"
            variables[f"{name}_{q}"] = xr.Variable(
                ("chain", "draw"), values, {"unit": unit, "long_name": words}
            )

    for q, each in found.items():
        typical = np.exp(draws[intercept(parameter_of(q))].to_numpy())
        known = bool((each.people > 0).any())
        forms = {"C": "consistency", "A": "agreement"}
        for letter, number in ((a, b) for b in ("1", "k") for a in forms) if known else ():
            values = each.icc(agreement=letter == "A", averaged=number == "k")
            form = f"ICC({letter},{number})" + (f", k = {each.k:g}" if number == "k" else "")
            told(q, ICC, form, values, "1", f"ICC_{letter}{number}")
        parts = {words: each.error(agreement=letter == "A") for letter, words in forms.items()}
        chain = np.full_like(typical, each.measurement)
        # Of the error: what the chain makes, and what the person does.
        parts |= {"measuring chain": chain, "person": parts["consistency"] - each.measurement}
        for words, variance in parts.items():
            short = {"agreement": "A", "consistency": "C", "measuring chain": "chain", "person": "person"}[
                words
            ]
            for measure, name, factor in ((SEM, "SEM", 1.0), (MDC, "MDC95", _DETECTABLE)):
                if measure == MDC and words not in forms.values():
                    continue
                relative = np.expm1(factor * np.sqrt(np.maximum(variance, 0.0)))
                told(q, measure, words, 100 * relative, _PERCENT, f"relative_{name}_{short}")
                told(q, measure, words, relative * typical, _UNITS.get(q, "1"), f"{name}_{short}")
        for letter in forms if known else ():
            for target in TARGETS:
                values = each.repeats(target, agreement=letter == "A")
                form = f"ICC({letter},k) of {target:g}"
                name = f"repeats_{letter}{100 * target:.0f}"
                told(q, REPEATS, form, values, "1", name)
                rows[-1] = (q, REPEATS, form, *(max(1.0, np.ceil(v)) for v in rows[-1][3:6]), "1")
    return pd.DataFrame(rows, columns=COLUMNS), xr.Dataset(variables)
