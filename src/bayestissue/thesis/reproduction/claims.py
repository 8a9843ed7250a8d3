"""The numbers claimed in the running text of chapters 5 to 7, recomputed one by one."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from bayestissue.recordings.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import (
    PublishedNumber,
    Recomputed,
    Rounded,
    agrees,
    difference,
    line,
    ratio,
)
from bayestissue.thesis.reproduction.conditions import (
    NEVER_TABULATED,
    QUANTITIES,
    Quantity,
    conditions,
    factors,
    grand_mean,
    rounding_norm,
    sum_of_squares,
)
from bayestissue.thesis.reproduction.relations import (
    ALPHA,
    candidates,
    correlation_of_averages,
    correlation_of_impacts,
    correlations_of_impacts,
    select_forward,
)


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
    known = float(table["maximum"].max())
    ends = [(known, known)]
    for _, lost in table[~table["from_rows"]].iterrows():
        average, rounding, n = lost["average"], lost["average_rounding"], int(lost["impacts"])
        spread = lost["range"] + lost["range_rounding"]
        low, high = deviation_of_largest(lost["sd"] + lost["sd_rounding"], spread, n)
        ends.append((average + low - rounding, average + high + rounding))
    return Extreme(*map(max, zip(*ends, strict=True)))


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


# Of a statistic: the two ends that it follows from, and how.
DERIVED = {
    "range": ("minimum", "maximum", difference),
    "ratio of maximum to minimum": ("minimum", "maximum", ratio),
    "range of trial averages": ("minimum of trial averages", "maximum of trial averages", difference),
    "ratio of trial averages": ("minimum of trial averages", "maximum of trial averages", ratio),
}
_CORRELATION = re.compile(r"correlation (?P<averaged>of trial averages )?with (?P<name>.+)")


@dataclass(frozen=True)
class Evidence:
    """What the tables say of one quantity."""

    published: PublishedTables
    quantity: Quantity

    @cached_property
    def table(self) -> pd.DataFrame:
        """The conditions, as `conditions` gives them."""
        return conditions(self.published, self.quantity)

    @cached_property
    def rounding(self) -> float:
        """How far the rounding of the printed numbers can have moved a single impact."""
        return float(self.table["average_rounding"].max())

    def statistic(self, name: str) -> Recomputed:
        """A statistic, by the name that it has among the claims."""
        if matched := _CORRELATION.fullmatch(name):
            correlation = correlation_of_averages if matched["averaged"] else correlation_of_impacts
            return correlation(matched["name"], self.table)
        return self._statistics.get(name, Recomputed(None, note="no rule recomputes this statistic"))

    @cached_property
    def _statistics(self) -> dict[str, Recomputed]:
        table = self.table
        extremes = {"minimum": smallest(table), "maximum": largest(table)}
        averages = {
            "minimum of trial averages": self._average(int(table["average"].argmin())),
            "maximum of trial averages": self._average(int(table["average"].argmax())),
        }
        ends = averages | {name: self._possible_end(name, extreme) for name, extreme in extremes.items()}
        return {
            "mean": Recomputed(grand_mean(table), self.rounding),
            "variance": self._variance(),
            **{name: self._end_of_impacts(extreme) for name, extreme in extremes.items()},
            **averages,
            **{name: _of_ends(rule, ends[low], ends[high]) for name, (low, high, rule) in DERIVED.items()},
            **self._counts(),
        }

    def _variance(self) -> Recomputed:
        """Sums of squares within and between conditions over n - 1; ‖y + e‖² moves by 2‖y‖‖e‖ + ‖e‖²."""
        squares, error = sum_of_squares(self.table), rounding_norm(self.table)
        degrees = float(self.table["impacts"].sum()) - 1
        return Recomputed(squares / degrees, (2 * np.sqrt(squares) * error + error**2) / degrees)

    def _end_of_impacts(self, extreme: Extreme) -> Recomputed:
        """The smallest or largest of all impacts, where the impacts that remain decide it."""
        if extreme.decided:
            return Recomputed(extreme.low, self.rounding)
        return Recomputed(
            None,
            note="its impact is lost; the impacts that remain and the printed average, standard deviation "
            f"and range of the lost trials put it between {extreme.low:.3f} and {extreme.high:.3f}",
        )

    def _possible_end(self, name: str, extreme: Extreme) -> Recomputed:
        """The same; where it isn't decided, the text's, if that is possible at all."""
        if extreme.decided:
            return self._end_of_impacts(extreme)
        claims = self.published.claims
        values = claims["value"][(claims["quantity"] == self.quantity) & (claims["statistic"] == name)]
        possible = values[values.between(extreme.low, extreme.high)]
        if possible.empty:
            return Recomputed(None, note=f"the {name} is lost, and the text gives none that is possible")
        value = float(possible.iloc[0])
        note = f"the {name} is the {value:g} of the text, since its impact is lost"
        return Recomputed(value, self.rounding, note)

    def _average(self, position: int) -> Recomputed:
        """The average of a condition."""
        condition = self.table.reset_index().iloc[position]
        lost = f"the average of trial {condition['trial']} as printed: its impacts are lost"
        note = "" if condition["from_rows"] else lost
        return Recomputed(float(condition["average"]), float(condition["average_rounding"]), note)

    def _counts(self) -> dict[str, Recomputed]:
        """How many trials, people, estimates and variables there are, and variables of some kind.

        Variables are those of Table 5.12 (significance and order of their correlations over all impacts) and
        of Table 5.17 (forward selection among them, equal products counted once).
        """
        estimates, correlations = (
            self.published.estimates,
            correlations_of_impacts(self.published, self.table),
        )
        leading = np.cumprod(["mass" in factors(name) for name in correlations.index])
        stepwise = self.published.stepwise
        rows = stepwise[stepwise["quantity"] == self.quantity]
        entered = select_forward(self.table["average"], candidates(rows["variable"], self.table))
        printed = (rows["status"] == "entered").sum()
        names = stepwise["variable"]
        recomputed = f"of the {len(correlations)} that can be recomputed"
        counts = {
            "number of trials": (len(self.table), ""),
            "number of subjects": (estimates["subject"].nunique(), ""),
            "number of estimates": (self.table["impacts"].sum(), f"{len(estimates)} of them remain"),
            "number of variables significantly correlated": (
                (correlations["p"] < ALPHA).sum(),
                f"{recomputed}, at {ALPHA}",
            ),
            "highest correlations with mass as a component": (leading.sum(), recomputed),
            "number of variables in the final stepwise model": (
                len(entered),
                f"without skin fold and muscle thickness; Table 5.17 enters {printed}",
            ),
            "number of variables available to the stepwise analysis": (
                names.map(factors).nunique(),
                f"Table 5.17 lists {names.nunique()} names, of which equal products are counted once",
            ),
        }
        return {name: Recomputed(float(count), note=note) for name, (count, note) in counts.items()}


def _of_ends(rule: Callable[[Rounded, Rounded], Rounded], low: Recomputed, high: Recomputed) -> Recomputed:
    """What follows from a smallest and a largest number, where both are known."""
    note = "; ".join(filter(None, (low.note, high.note)))
    if low.value is None or high.value is None:
        return Recomputed(None, note=note)
    return Recomputed(*rule((low.value, low.rounding), (high.value, high.rounding)), note)


def claim_lines(published: PublishedTables) -> Iterator[PublishedNumber]:
    """Every claim of the text beside what the tables say; ``row`` is the number of the claim."""
    evidence: dict[str, Evidence] = {quantity: Evidence(published, quantity) for quantity in QUANTITIES}
    evidence["design"] = evidence["K"]
    for _, claim in published.claims.iterrows():
        statistic, quantity = claim["statistic"], claim["quantity"]
        name = statistic if quantity == "design" else f"{quantity}: {statistic}"
        recomputed = Recomputed(None, note=NEVER_TABULATED)
        if quantity in evidence:
            recomputed = evidence[quantity].statistic(statistic)
        recomputed = replace(recomputed, hint=_hint(claim, published.claims, recomputed))
        yield line(f"section {claim['section']}", int(claim["claim"]), name, claim["value_text"], recomputed)


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
