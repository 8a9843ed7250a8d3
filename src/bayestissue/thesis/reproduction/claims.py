"""The numbers claimed in the running text of chapters 5 to 7, recomputed one by one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import Line, Recomputed, agrees, line
from bayestissue.thesis.reproduction.conditions import (
    NEVER_TABULATED,
    QUANTITIES,
    Quantity,
    between_sum_of_squares,
    conditions,
    factors,
    grand_mean,
    has_mass,
    rounding_norm,
    within_sum_of_squares,
)
from bayestissue.thesis.reproduction.correlations import (
    correlation_of_averages,
    correlation_of_impacts,
    p_value,
)
from bayestissue.thesis.reproduction.regressions import ALPHA, candidates, select_forward


@dataclass(frozen=True)
class Extreme:
    """Bounds on the smallest or largest impact; ``low`` equals ``high`` where it is decided."""

    low: float
    high: float

    @property
    def decided(self) -> bool:
        """Whether the impacts that remain decide it."""
        return self.low == self.high


def largest(table: pd.DataFrame) -> Extreme:
    """Bounds on the largest of all impacts of a table of `conditions`.

    A lost condition has its largest impact between average + d_low and average + d_high, where
    `deviation_of_largest` gives both; remaining impacts are known.
    """
    lost = table[~table["from_rows"]]
    known = float(table["maximum"].max())
    ends = [_largest_of_lost(condition) for _, condition in lost.iterrows()]
    low, high = (max([known, *values]) for values in zip(*ends, strict=True)) if ends else (known, known)
    return Extreme(low, high)


def smallest(table: pd.DataFrame) -> Extreme:
    """Bounds on the smallest of all impacts: `largest` of the impacts with their signs turned."""
    turned = largest(
        table.assign(average=-table["average"], minimum=-table["maximum"], maximum=-table["minimum"])
    )
    return Extreme(-turned.high, -turned.low)


def deviation_of_largest(sd: float, spread: float, n: int) -> tuple[float, float]:
    """How far above their average the largest of ``n`` numbers can lie, given their sd and range.

    With d the deviation of the largest and d - R that of the smallest, the other n - 2 deviations sum to
    R - 2d, so their squares sum to at least (R - 2d)²/(n-2), and
    d² + (d - R)² + (R - 2d)²/(n-2) ≤ (n-1) s². Besides, R/n ≤ d ≤ R (n-1)/n whatever the sd.
    """
    low, high = spread / n, spread * (n - 1) / n
    if n < 3:
        return low, high
    a = 2 + 4 / (n - 2)
    root = spread**2 - 4 * (spread**2 * (1 + 1 / (n - 2)) - (n - 1) * sd**2) / a
    # A negative root means that the printed sd and range exclude each other; only the range is used then.
    if root < 0:
        return low, high
    half = np.sqrt(root)
    return max(low, float(spread - half) / 2), min(high, float(spread + half) / 2)


def _largest_of_lost(condition: pd.Series) -> tuple[float, float]:
    n, rounding = int(condition["impacts"]), condition["average_rounding"]
    spread = condition["range"] + condition["range_rounding"]
    low, high = deviation_of_largest(condition["sd"] + condition["sd_rounding"], spread, n)
    return condition["average"] + low - rounding, condition["average"] + high + rounding


@dataclass(frozen=True)
class Evidence:
    """What the tables say of one quantity; every public method recomputes one claimed statistic."""

    published: PublishedTables
    quantity: Quantity

    @cached_property
    def table(self) -> pd.DataFrame:
        """The conditions, as `conditions` gives them."""
        return conditions(self.published, self.quantity)

    @cached_property
    def _correlations(self) -> dict[str, float]:
        """Correlations over all impacts with the variables of Table 5.12 that can be recomputed."""
        rows = self.published.correlations
        names = rows.loc[rows["table"] == "5.12", "variable"]
        recomputed = {name: correlation_of_impacts(name, self.table).value for name in names}
        return {name: value for name, value in recomputed.items() if value is not None}

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
        """The mean of all impacts."""
        return Recomputed(grand_mean(self.table), rounding=self._row_rounding)

    def variance(self) -> Recomputed:
        """Sums of squares within and between conditions over n - 1; ‖y + e‖² moves by 2‖y‖‖e‖ + ‖e‖²."""
        squares = within_sum_of_squares(self.table) + between_sum_of_squares(self.table)
        degrees = float(self.table["impacts"].sum()) - 1
        error = rounding_norm(self.table)
        return Recomputed(squares / degrees, rounding=(2 * np.sqrt(squares) * error + error**2) / degrees)

    def minimum(self) -> Recomputed:
        """The smallest impact, where the impacts that remain decide it."""
        return self._extreme(self._smallest)

    def maximum(self) -> Recomputed:
        """The largest impact, where the impacts that remain decide it."""
        return self._extreme(self._largest)

    def range(self) -> Recomputed:
        """The largest less the smallest impact."""
        low, high, note = self._ends()
        if low is None or high is None:
            return Recomputed(None, note=note)
        return Recomputed(high - low, rounding=2 * self._row_rounding, note=note)

    def ratio(self) -> Recomputed:
        """The largest over the smallest impact."""
        low, high, note = self._ends()
        if low is None or high is None:
            return Recomputed(None, note=note)
        return Recomputed(high / low, rounding=self._row_rounding * (high / low + 1) / low, note=note)

    def minimum_of_averages(self) -> Recomputed:
        """The smallest average of a condition."""
        return self._average(float(self.table["average"].min()))

    def maximum_of_averages(self) -> Recomputed:
        """The largest average of a condition."""
        return self._average(float(self.table["average"].max()))

    def range_of_averages(self) -> Recomputed:
        """The largest less the smallest average."""
        low, high = self.minimum_of_averages(), self.maximum_of_averages()
        return Recomputed(
            _value(high) - _value(low), rounding=low.rounding + high.rounding, note=high.note or low.note
        )

    def ratio_of_averages(self) -> Recomputed:
        """The largest over the smallest average."""
        low, high = self.minimum_of_averages(), self.maximum_of_averages()
        ratio = _value(high) / _value(low)
        rounding = (high.rounding + ratio * low.rounding) / _value(low)
        return Recomputed(ratio, rounding=rounding, note=high.note or low.note)

    def with_mass_among_highest(self) -> Recomputed:
        """How many variables of Table 5.12 lead the order of absolute correlations and have mass in them."""
        order = sorted(self._correlations, key=lambda name: -abs(self._correlations[name]))
        leading = np.cumprod([has_mass(name) for name in order])
        return Recomputed(float(leading.sum()), note=f"of the {len(order)} that can be recomputed")

    def significantly_correlated(self) -> Recomputed:
        """How many variables of Table 5.12 correlate with the quantity over all impacts, p below `ALPHA`."""
        n = float(self.table["impacts"].sum())
        p_values = [p_value(r, n) for r in self._correlations.values()]
        count = sum(p < ALPHA for p in p_values)
        return Recomputed(float(count), note=f"of the {len(p_values)} that can be recomputed, at {ALPHA}")

    def in_final_model(self) -> Recomputed:
        """How many variables of Table 5.17 forward selection enters."""
        rows = self.published.stepwise.query("quantity == @self.quantity")
        entered = select_forward(self.table["average"], candidates(rows["variable"], self.table))
        printed = (rows["status"] == "entered").sum()
        return Recomputed(
            float(len(entered)), note=f"without skin fold and muscle thickness; Table 5.17 enters {printed}"
        )

    def _extreme(self, extreme: Extreme) -> Recomputed:
        if extreme.decided:
            return Recomputed(extreme.low, rounding=self._row_rounding)
        return Recomputed(
            None,
            note="its impact is lost; the impacts that remain and the printed average, standard deviation "
            f"and range of the lost trials put it between {extreme.low:.3f} and {extreme.high:.3f}",
        )

    def _ends(self) -> tuple[float | None, float | None, str]:
        """Smallest and largest impact; where one isn't decided, the text's, if that is possible at all."""
        ends: list[float | None] = []
        notes = []
        for name, extreme in (("minimum", self._smallest), ("maximum", self._largest)):
            value: float | None = extreme.low
            if not extreme.decided:
                value = self._claimed(name, extreme)
                notes.append(
                    f"the {name} is lost, and the text gives none that is possible"
                    if value is None
                    else f"the {name} is the {value:g} of the text, since its impact is lost"
                )
            ends.append(value)
        return ends[0], ends[1], "; ".join(notes)

    def _claimed(self, statistic: str, extreme: Extreme) -> float | None:
        claims = self.published.claims
        values = claims["value"][(claims["quantity"] == self.quantity) & (claims["statistic"] == statistic)]
        return next((float(value) for value in values if extreme.low <= value <= extreme.high), None)

    def _average(self, value: float) -> Recomputed:
        """The condition whose average is ``value``."""
        condition = self.table[self.table["average"] == value].reset_index().iloc[0]
        lost = f"the average of trial {condition['trial']} as printed: its impacts are lost"
        note = "" if condition["from_rows"] else lost
        return Recomputed(value, rounding=float(condition["average_rounding"]), note=note)


def _value(recomputed: Recomputed) -> float:
    return float("nan") if recomputed.value is None else recomputed.value


def claim_lines(published: PublishedTables) -> list[Line]:
    """Every claim of the text beside what the tables say; ``row`` is the number of the claim."""
    evidence: dict[str, Evidence] = {quantity: Evidence(published, quantity) for quantity in QUANTITIES}
    claims = published.claims
    recomputations = [_recompute(claim, published, evidence) for _, claim in claims.iterrows()]
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
        for (_, claim), recomputed in zip(claims.iterrows(), recomputations, strict=True)
    ]


_STATISTICS: dict[str, Callable[[Evidence], Recomputed]] = {
    "mean": Evidence.mean,
    "variance": Evidence.variance,
    "minimum": Evidence.minimum,
    "maximum": Evidence.maximum,
    "range": Evidence.range,
    "ratio of maximum to minimum": Evidence.ratio,
    "minimum of trial averages": Evidence.minimum_of_averages,
    "maximum of trial averages": Evidence.maximum_of_averages,
    "range of trial averages": Evidence.range_of_averages,
    "ratio of trial averages": Evidence.ratio_of_averages,
    "number of variables significantly correlated": Evidence.significantly_correlated,
    "number of variables in the final stepwise model": Evidence.in_final_model,
    "highest correlations with mass as a component": Evidence.with_mass_among_highest,
}
_CORRELATION = re.compile(r"correlation (?P<averaged>of trial averages )?with (?P<name>.+)")


def _recompute(claim: pd.Series, published: PublishedTables, evidence: dict[str, Evidence]) -> Recomputed:
    statistic, quantity = claim["statistic"], claim["quantity"]
    if quantity == "design":
        return _design(statistic, published, evidence["K"].table)
    if quantity not in evidence:
        return Recomputed(None, note=NEVER_TABULATED)
    if statistic in _STATISTICS:
        return _STATISTICS[statistic](evidence[quantity])
    if matched := _CORRELATION.fullmatch(statistic):
        correlation = correlation_of_averages if matched["averaged"] else correlation_of_impacts
        return correlation(matched["name"], evidence[quantity].table)
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


def _hint(claim: pd.Series, claims: pd.DataFrame, recomputed: Recomputed) -> str:
    """Where the number may come from: another claimed statistic, or a place where the text has it right."""
    if recomputed.value is None or agrees(claim["value_text"], recomputed.value):
        return ""
    same = claims[claims["quantity"] == claim["quantity"]]
    # Two small counts are equal by chance; two numbers with digits after the point hardly are.
    printed = "." in claim["value_text"]
    others = same[printed & (same["value"] == claim["value"]) & (same["statistic"] != claim["statistic"])]
    hints = [f"repeats the {statistic}" for statistic in others["statistic"].unique()]
    right = same[(same["statistic"] == claim["statistic"]) & (same["value"] != claim["value"])]
    hints += [
        f"section {claim_elsewhere['section']} prints {claim_elsewhere['value_text']}, which agrees"
        for _, claim_elsewhere in right.drop_duplicates("value").iterrows()
        if agrees(claim_elsewhere["value_text"], recomputed.value)
    ]
    return "; ".join(hints)
