"""The numbers claimed in the running text of chapters 5 to 7, recomputed one by one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.reproduction.agreement import Line, Recomputed, agrees, line
from bayestissue.reproduction.conditions import (
    QUANTITIES,
    Quantity,
    between_sum_of_squares,
    conditions,
    grand_mean,
    rounding_norm,
    within_sum_of_squares,
)
from bayestissue.reproduction.correlations import correlation_of_averages, correlation_of_impacts
from bayestissue.reproduction.covariates import NEVER_TABULATED, covariate, factors, has_mass
from bayestissue.reproduction.extremes import Extreme, largest, smallest


def claim_lines(published: PublishedTables) -> list[Line]:
    """Every claim of the text beside what the tables say; ``row`` is the number of the claim."""
    evidence: dict[str, _Evidence] = {quantity: _Evidence(published, quantity) for quantity in QUANTITIES}
    claims = published.claims
    found = [_recompute(claim, published, evidence) for _, claim in claims.iterrows()]
    return [
        line(
            f"section {claim['section']}",
            int(claim["claim"]),
            claim["statistic"]
            if claim["quantity"] == "design"
            else f"{claim['quantity']}: {claim['statistic']}",
            claim["value_text"],
            replace(recomputed, hint=_hint(claim, claims, recomputed)),
        )
        for (_, claim), recomputed in zip(claims.iterrows(), found, strict=True)
    ]


@dataclass(frozen=True)
class _Evidence:
    """What the tables say of one quantity; every public method recomputes one claimed statistic."""

    published: PublishedTables
    quantity: Quantity

    @cached_property
    def table(self) -> pd.DataFrame:
        return conditions(self.published, self.quantity)

    @cached_property
    def _largest(self) -> Extreme:
        return largest(self.table)

    @cached_property
    def _smallest(self) -> Extreme:
        return smallest(self.table)

    @cached_property
    def _row_rounding(self) -> float:
        return float(self.table["average_rounding"].max())

    def mean(self) -> Recomputed:
        return Recomputed(grand_mean(self.table), rounding=self._row_rounding)

    def variance(self) -> Recomputed:
        """Sums of squares within and between conditions over n - 1; ‖y + e‖² moves by 2‖y‖‖e‖ + ‖e‖²."""
        squares = within_sum_of_squares(self.table) + between_sum_of_squares(self.table)
        degrees = float(self.table["impacts"].sum()) - 1
        error = rounding_norm(self.table)
        return Recomputed(squares / degrees, rounding=(2 * np.sqrt(squares) * error + error**2) / degrees)

    def minimum(self) -> Recomputed:
        return self._extreme(self._smallest)

    def maximum(self) -> Recomputed:
        return self._extreme(self._largest)

    def range(self) -> Recomputed:
        low, high, note = self._ends()
        if low is None or high is None:
            return Recomputed(None, note=note)
        return Recomputed(high - low, rounding=2 * self._row_rounding, note=note)

    def ratio(self) -> Recomputed:
        low, high, note = self._ends()
        if low is None or high is None:
            return Recomputed(None, note=note)
        return Recomputed(high / low, rounding=self._row_rounding * (high / low + 1) / low, note=note)

    def minimum_of_averages(self) -> Recomputed:
        return self._average(float(self.table["average"].min()))

    def maximum_of_averages(self) -> Recomputed:
        return self._average(float(self.table["average"].max()))

    def range_of_averages(self) -> Recomputed:
        low, high = self.minimum_of_averages(), self.maximum_of_averages()
        return Recomputed(
            _value(high) - _value(low), rounding=low.rounding + high.rounding, note=high.note or low.note
        )

    def ratio_of_averages(self) -> Recomputed:
        low, high = self.minimum_of_averages(), self.maximum_of_averages()
        ratio = _value(high) / _value(low)
        rounding = (high.rounding + ratio * low.rounding) / _value(low)
        return Recomputed(ratio, rounding=rounding, note=high.note or low.note)

    def with_mass_among_highest(self) -> Recomputed:
        """How many variables of Table 5.12 lead the order of absolute correlations and have mass in them."""
        rows = self.published.correlations
        names = [name for name in rows.loc[rows["table"] == "5.12", "variable"] if _known(name, self.table)]
        order = sorted(names, key=lambda name: -abs(_value(correlation_of_impacts(name, self.table))))
        leading = np.cumprod([has_mass(name) for name in order])
        return Recomputed(float(leading.sum()), note=f"of the {len(order)} that can be recomputed")

    def correlation(self, name: str) -> Recomputed:
        return correlation_of_impacts(name, self.table)

    def averaged_correlation(self, name: str) -> Recomputed:
        return correlation_of_averages(name, self.table)

    def _extreme(self, extreme: Extreme) -> Recomputed:
        if extreme.decided:
            return Recomputed(extreme.low, rounding=self._row_rounding)
        return Recomputed(
            None,
            note="its impact is lost; the impacts that remain and the printed average, standard deviation "
            f"and range of the lost trials put it between {extreme.low:.3f} and {extreme.high:.3f}",
        )

    def _ends(self) -> tuple[float | None, float | None, str]:
        """Smallest and largest impact; where one isn't decided, the one that the text claims first."""
        ends, notes = [], []
        for name, extreme in (("minimum", self._smallest), ("maximum", self._largest)):
            value: float | None = extreme.low
            if not extreme.decided:
                value = self._claimed(name)
                notes.append(f"the {name} is the {value} of the text, since its impact is lost")
            ends.append(value)
        return ends[0], ends[1], "; ".join(notes)

    def _claimed(self, statistic: str) -> float | None:
        claims = self.published.claims
        values = claims["value"][(claims["quantity"] == self.quantity) & (claims["statistic"] == statistic)]
        return None if values.empty else float(values.iloc[0])

    def _average(self, value: float) -> Recomputed:
        """The condition whose average is ``value``."""
        condition = self.table[self.table["average"] == value].reset_index().iloc[0]
        lost = f"the average of trial {condition['trial']} as printed: its impacts are lost"
        note = "" if condition["from_rows"] else lost
        return Recomputed(value, rounding=float(condition["average_rounding"]), note=note)


_STATISTICS: dict[str, Callable[[_Evidence], Recomputed]] = {
    "mean": _Evidence.mean,
    "variance": _Evidence.variance,
    "minimum": _Evidence.minimum,
    "maximum": _Evidence.maximum,
    "range": _Evidence.range,
    "ratio of maximum to minimum": _Evidence.ratio,
    "minimum of trial averages": _Evidence.minimum_of_averages,
    "maximum of trial averages": _Evidence.maximum_of_averages,
    "range of trial averages": _Evidence.range_of_averages,
    "ratio of trial averages": _Evidence.ratio_of_averages,
    "highest correlations with mass as a component": _Evidence.with_mass_among_highest,
}
_CORRELATION = re.compile(r"correlation (?P<averaged>of trial averages )?with (?P<name>.+)")


def _recompute(claim: pd.Series, published: PublishedTables, evidence: dict[str, _Evidence]) -> Recomputed:
    statistic, quantity = claim["statistic"], claim["quantity"]
    if quantity == "design":
        return _design(statistic, published, evidence["K"].table)
    if quantity not in evidence:
        return Recomputed(None, note=NEVER_TABULATED)
    if statistic in _STATISTICS:
        return _STATISTICS[statistic](evidence[quantity])
    if matched := _CORRELATION.fullmatch(statistic):
        of = (
            evidence[quantity].averaged_correlation if matched["averaged"] else evidence[quantity].correlation
        )
        return of(matched["name"])
    return Recomputed(None, note="no rule recomputes this statistic")


def _design(statistic: str, published: PublishedTables, table: pd.DataFrame) -> Recomputed:
    left = f"{len(published.estimates)} of them remain"
    names = published.stepwise["variable"]
    known: dict[str, tuple[float, str]] = {
        "number of trials": (len(table), ""),
        "number of subjects": (published.estimates["subject"].nunique(), ""),
        "number of estimates": (table["impacts"].sum(), left),
        "number of variables available to the stepwise analysis": (
            names.map(factors).nunique(),
            f"Table 5.17 lists {names.nunique()} names, of which equal products are counted once",
        ),
    }
    if statistic not in known:
        return Recomputed(None, note="no rule recomputes this statistic")
    value, note = known[statistic]
    return Recomputed(float(value), note=note)


def _hint(claim: pd.Series, claims: pd.DataFrame, found: Recomputed) -> str:
    """Where the number may come from: another claimed statistic, or a place where the text has it right."""
    if found.value is None or agrees(claim["value_text"], found.value):
        return ""
    same = claims[claims["quantity"] == claim["quantity"]]
    others = same[(same["value"] == claim["value"]) & (same["statistic"] != claim["statistic"])]
    hints = [f"repeats the {statistic}" for statistic in others["statistic"].unique()]
    right = same[(same["statistic"] == claim["statistic"]) & (same["value"] != claim["value"])]
    hints += [
        f"section {other['section']} prints {other['value_text']}, which agrees"
        for _, other in right.drop_duplicates("value").iterrows()
        if agrees(other["value_text"], found.value)
    ]
    return "; ".join(hints)


def _known(name: str, table: pd.DataFrame) -> bool:
    return covariate(name, table) is not None


def _value(found: Recomputed) -> float:
    return float("nan") if found.value is None else found.value
