"""Reliability: how repeatable a measured K or C of a person is; agreement of two methods.

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

The standard error of measurement is s = (I + M)^1/2 for a repeat, which shares all levels with the first
measurement (side, session, condition), E^1/2 for consistency and (A + E)^1/2 for agreement on the log scale:
in percent exp(s) - 1, in units that share of a typical person's K or C. The minimal detectable change between
two measurements of a person is exp(1.96 2^1/2 s) - 1 (Weir 2005, doi:10.1519/15184.1); S, in both alike, is
none of it. Between means of k measurements each variance is divided as in the ICC of k. ``varies`` names the
groups whose levels may differ between the measurements compared; what no group of the formula is of, such as
another day, is the same in both. By Spearman and Brown's formula an ICC of R needs

    k = R E / (P (1 - R) - R S)         (with A + E for agreement)

repeats, each in a condition of its own; where S leaves less than R, no number of them is enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Float

from bayestissue.base.results.tables import table_of_rows
from bayestissue.inference.results.meanings import ICC, MDC, REPEATS, SEM, UNITS
from bayestissue.inference.results.summary import prior_overlap
from bayestissue.model.hierarchy.formulas.group_terms import SUBJECT, TRIAL, GroupTerm, grouping_of
from bayestissue.model.hierarchy.recorded import Recorded
from bayestissue.model.hierarchy.responses import parameter_of, sd_impact

TARGETS = (0.75, 0.9)
# What two measurements are compared for; a repeat shares all levels with the first.
FORMS = {"R": "repeat", "C": "consistency", "A": "agreement"}
# Standard deviations of a normal about its mean that hold 95 % of it.
SD_OF_95_PERCENT = 1.96
_PERCENT = "%"

Drawn = Float[np.ndarray, "*draw"]


class Variances(NamedTuple):
    """Variances of log q: see the module.

    Those of ``agreement`` and ``within`` stand by their grouping, each with its levels in k impacts.
    """

    people: Drawn
    shared: float
    agreement: Mapping[str, tuple[Drawn, float]]
    within: Mapping[str, tuple[Drawn, float]]
    impacts: Drawn
    measurement: float
    k: float

    def varying(self, form: str) -> Mapping[str, tuple[Drawn, float]]:
        """The groups whose levels may differ between measurements compared by a form of `FORMS`."""
        return {**(self.within if form != "R" else {}), **(self.agreement if form == "A" else {})}

    def error(self, form: str, *, averaged: bool = False) -> Drawn:
        """Variance of one measurement, or of the mean of k, about what those compared have in common."""
        groups = self.varying(form).values()
        of_groups = [variance / (levels if averaged else 1) for variance, levels in groups]
        return np.sum(of_groups, axis=0) + (self.impacts + self.measurement) / (self.k if averaged else 1)

    def icc(self, form: str, *, averaged: bool = False) -> Drawn:
        """The intraclass correlation: squared correlation of what is measured and the person's own value."""
        return self.people / (self.people + self.shared + self.error(form, averaged=averaged))

    def repeats(self, target: float, form: str) -> Drawn:
        """How many measurements have a mean of this ICC; a fraction, and infinite where none have."""
        left = self.people * (1 - target) - target * self.shared
        with np.errstate(divide="ignore"):
            return np.where(left > 0, target * self.error(form) / np.maximum(left, 0), np.inf)


def variances(
    draws: xr.Dataset, recorded: Recorded, response: str, *, measurement_sd: float, shared_sd: float = 0.0
) -> Variances:
    """Those of one response; ``people`` are 0 where the formula has no effect of the person."""
    people = np.zeros((draws.sizes["chain"], draws.sizes["draw"]))
    groups: dict[str, dict[str, tuple[np.ndarray, float]]] = {"agreement": {}, "within": {}}
    for term in recorded.response(response).terms.groups:
        if term.slope:
            continue
        variance = draws[term.sd(response)].to_numpy() ** 2
        levels, kind = _place(recorded, term)
        if kind == "people":
            people = people + variance
        else:
            groups[kind][term.grouping] = variance, levels
    impacts = draws[sd_impact(parameter_of(response))].to_numpy() ** 2
    k = float(recorded.rows.groupby("subject").size().median())
    return Variances(people, shared_sd**2, **groups, impacts=impacts, measurement=measurement_sd**2, k=k)


def _place(recorded: Recorded, term: GroupTerm) -> tuple[float, str]:
    """Levels of a grouping that a person went through (median), and which variance it is part of."""
    code = grouping_of(recorded.rows, term.factors).code
    pairs = pd.DataFrame({"level": code, "person": recorded.rows["subject"]}).drop_duplicates()
    of_person, of_level = pairs.groupby("person").size(), pairs.groupby("level").size()
    levels = float(of_person.median())
    if term == SUBJECT or (term != TRIAL and of_person.max() == 1):
        return levels, "people"
    return levels, "within" if of_level.max() == 1 else "agreement"


class Coefficient(NamedTuple):
    """A coefficient in every draw; ``name`` is that of its variable, without the response.

    ``varies`` are the groupings whose levels may differ between the measurements that it is of.
    """

    quantity: str
    measure: str
    form: str
    unit: str
    name: str
    drawn: Drawn
    varies: tuple[str, ...] = ()

    def of_units(self, typical: Drawn) -> Iterator[Coefficient]:
        """A difference of the log in percent, and in the quantity's unit beside what is ``typical``."""
        relative, unit = np.expm1(self.drawn), UNITS.get(self.quantity, "1")
        yield self._replace(unit=_PERCENT, name=f"relative_{self.name}", drawn=100 * relative)
        yield self._replace(unit=unit, drawn=relative * typical)


def coefficients(
    draws: xr.Dataset, recorded: Recorded, measurement_sd: Mapping[str, float], shared_sd: float = 0.0
) -> list[Coefficient]:
    """Every coefficient in ``draws``, of the group posterior or prior.

    Args:
        draws: of which group.
        recorded: what was measured.
        measurement_sd: of each response that is asked for, of the log of one measurement.
        shared_sd: of an error of the log mass that all impacts of a person share.
    """
    of_all: list[Coefficient] = []
    for q, sd in measurement_sd.items():
        of_all += coefficients_of(
            q, variances(draws, recorded, q, measurement_sd=sd, shared_sd=shared_sd), draws
        )
    return of_all


def coefficients_of(q: str, variances: Variances, draws: xr.Dataset) -> Iterator[Coefficient]:
    """Those of one response, by its variances in ``draws``."""
    typical = draws[f"{q}_typical_person"].to_numpy()
    forms_of_icc = ("C", "A") if (variances.people > 0).any() else ()
    varies = {form: tuple(variances.varying(form)) for form in FORMS}
    for averaged, form in product((False, True), forms_of_icc):
        number, k = ("k", f", k = {variances.k:g}") if averaged else ("1", "")
        values = variances.icc(form, averaged=averaged)
        yield Coefficient(
            q, ICC, f"ICC({form},{number}){k}", "1", f"ICC_{form}{number}", values, varies[form]
        )
    for form, averaged in product(FORMS, (False, True) if variances.k > 1 else (False,)):
        variance = variances.error(form, averaged=averaged)
        words, short = FORMS[form] + f", means of {variances.k:g}" * averaged, form + "k" * averaged
        if not averaged:
            error = Coefficient(q, SEM, words, "", f"SEM_{short}", np.sqrt(variance), varies[form])
            yield from error.of_units(typical)
        detectable = SD_OF_95_PERCENT * np.sqrt(2 * variance)
        change = Coefficient(q, MDC, words, "", f"MDC95_{short}", detectable, varies[form])
        yield from change.of_units(typical)
    # Of a repeat's error: what the chain makes, and what the person does.
    chain = np.full_like(typical, variances.measurement)
    for short, words, variance in (
        ("chain", "measuring chain", chain),
        ("person", "person", variances.impacts),
    ):
        yield from Coefficient(q, SEM, words, "", f"SEM_{short}", np.sqrt(variance)).of_units(typical)
    for form, target in product(forms_of_icc, TARGETS):
        words, short = f"ICC({form},k) of {target:g}", f"repeats_{form}{100 * target:.0f}"
        yield Coefficient(q, REPEATS, words, "1", short, variances.repeats(target, form), varies[form])


def reliability(posterior: Sequence[Coefficient], prior: Sequence[Coefficient] = ()) -> pd.DataFrame:
    """The coefficients as a table.

    Args:
        posterior: of the posterior's draws.
        prior: the same of the prior's, if there are any.

    Returns:
        ``reliability.csv``, with the median and the 90 % equal-tailed interval; repeats are whole numbers, at
        least 1.
        ``prior_overlap`` says how much of that is the prior: see
        `bayestissue.inference.results.summary`. ``varies`` names the groupings whose levels may differ
        between the measurements compared; all others are the same.
    """
    before = {coefficient[:5]: coefficient.drawn for coefficient in prior}
    rows = []
    for coefficient in posterior:
        ends = np.quantile(coefficient.drawn, [0.5, 0.05, 0.95], method="higher")
        if coefficient.measure == REPEATS:
            ends = np.maximum(1.0, np.ceil(ends))
        shared = (
            prior_overlap(coefficient.drawn, before[coefficient[:5]]) if coefficient[:5] in before else np.nan
        )
        quantity, measure, form, unit = coefficient[:4]
        rows.append((quantity, measure, form, *ends.tolist(), unit, shared, ", ".join(coefficient.varies)))
    return table_of_rows("reliability", rows)


def as_variables(coefficients: Sequence[Coefficient]) -> xr.Dataset:
    """The coefficients as variables of the draws, [chain, draw].

    Left out is what is the same in all draws, and repeats, which are fractions here, where no number of them
    is enough in some draw.
    """
    return xr.Dataset(
        {
            f"{coefficient.name}_{coefficient.quantity}": xr.Variable(
                ("chain", "draw"),
                coefficient.drawn,
                {
                    "unit": coefficient.unit,
                    "long_name": f"{coefficient.measure}, {coefficient.form}, of {coefficient.quantity}",
                },
            )
            for coefficient in coefficients
            if np.isfinite(coefficient.drawn).all() and np.ptp(coefficient.drawn) > 0
        }
    )


def limits_of_agreement(ratio: pd.Series) -> tuple[float, float, float]:
    """Of the ratios a / b of single impacts exp(mean d), d being their logs, and its 95 % limits.

    These are exp(mean d ± 1.96 sd d) (Bland and Altman 1999, doi:10.1177/096228029900800204, who take logs
    where differences grow with the size). What is not above 0, or no number, has no log and is left out.
    """
    d = np.log(ratio[(ratio > 0) & np.isfinite(ratio)])
    middle, half = d.mean(), SD_OF_95_PERCENT * d.std(ddof=1)
    return float(np.exp(middle)), float(np.exp(middle - half)), float(np.exp(middle + half))


def agreement(values: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """The thesis's method over the posterior, limits of agreement of single impacts: ``agreement.csv``.

    They are of people and conditions as recorded: impacts of one person are not independent, so that other
    people may differ.

    Args:
        values: of K and of C a row an impact, with the columns ``dds`` and ``posterior``. What is not above 0
            has no ratio, and is left out.

    Returns:
        ``ratio`` of the one over the other and its limits ``low`` and ``high``, for ``impacts`` of them.
    """
    rows = []
    for quantity, table in values.items():
        positive = table[((table > 0) & np.isfinite(table)).all(axis=1)]
        impacts, ends = len(positive), limits_of_agreement(positive["dds"] / positive["posterior"])
        rows.append((quantity, "dds", "posterior", impacts, len(table) - impacts, *ends))
    return table_of_rows("agreement", rows)
