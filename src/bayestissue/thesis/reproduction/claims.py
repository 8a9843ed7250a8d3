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
    p_value,
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
    """What the tables say of one quantity."""

    published: PublishedTables
    quantity: Quantity

    @cached_property
    def table(self) -> pd.DataFrame:
        """The conditions, as `conditions` gives them."""
        return conditions(self.published, self.quantity)

    @cached_property
    def correlations(self) -> dict[str, float]:
        """Correlations over all impacts with the variables of Table 5.12 that can be recomputed."""
        return correlations_of_impacts(self.published, self.table)

    @cached_property
    def rounding(self) -> float:
        """How far the rounding of the printed numbers can have moved a single impact."""
        return float(self.table["average_rounding"].max())

    def statistic(self, name: str) -> Recomputed:
        """A statistic, by the name that it has among the claims."""
        if name in _STATISTICS:
            return _STATISTICS[name](self)
        if matched := _CORRELATION.fullmatch(name):
            correlation = correlation_of_averages if matched["averaged"] else correlation_of_impacts
            return correlation(matched["name"], self.table)
        return Recomputed(None, note=_NO_RULE)

    def end_of_impacts(self, name: str) -> Recomputed:
        """The minimum or maximum of all impacts, where the impacts that remain decide it."""
        extreme = _EXTREMES[name](self.table)
        if extreme.decided:
            return Recomputed(extreme.low, self.rounding)
        return Recomputed(
            None,
            note="its impact is lost; the impacts that remain and the printed average, standard deviation "
            f"and range of the lost trials put it between {extreme.low:.3f} and {extreme.high:.3f}",
        )

    def possible_end_of_impacts(self, name: str) -> Recomputed:
        """The same; where it isn't decided, the text's, if that is possible at all."""
        extreme, claims = _EXTREMES[name](self.table), self.published.claims
        if extreme.decided:
            return Recomputed(extreme.low, self.rounding)
        values = claims["value"][(claims["quantity"] == self.quantity) & (claims["statistic"] == name)]
        possible = values[values.between(extreme.low, extreme.high)]
        if possible.empty:
            return Recomputed(None, note=f"the {name} is lost, and the text gives none that is possible")
        value = float(possible.iloc[0])
        note = f"the {name} is the {value:g} of the text, since its impact is lost"
        return Recomputed(value, self.rounding, note)

    def end_of_averages(self, name: str) -> Recomputed:
        """The smallest or largest average of a condition."""
        rows = self.table.reset_index()
        average = rows["average"]
        condition = rows.iloc[average.argmin() if name == "minimum" else average.argmax()]
        lost = f"the average of trial {condition['trial']} as printed: its impacts are lost"
        note = "" if condition["from_rows"] else lost
        return Recomputed(float(condition["average"]), float(condition["average_rounding"]), note)


def _variance(evidence: Evidence) -> Recomputed:
    """Sums of squares within and between conditions over n - 1; ‖y + e‖² moves by 2‖y‖‖e‖ + ‖e‖²."""
    table = evidence.table
    squares = sum_of_squares(table)
    degrees, error = float(table["impacts"].sum()) - 1, rounding_norm(table)
    return Recomputed(squares / degrees, (2 * np.sqrt(squares) * error + error**2) / degrees)


def _of_ends(rule: Callable[[Rounded, Rounded], Rounded], end: Callable[[str], Recomputed]) -> Recomputed:
    """What follows from a smallest and a largest number, where both are known."""
    low, high = end("minimum"), end("maximum")
    note = "; ".join(filter(None, (low.note, high.note)))
    if low.value is None or high.value is None:
        return Recomputed(None, note=note)
    return Recomputed(*rule((low.value, low.rounding), (high.value, high.rounding)), note)


def _with_mass_among_highest(evidence: Evidence) -> Recomputed:
    """How many variables of Table 5.12 lead the order of absolute correlations and have mass in them."""
    r = evidence.correlations
    leading = np.cumprod(["mass" in factors(name) for name in sorted(r, key=lambda name: -abs(r[name]))])
    return Recomputed(float(leading.sum()), note=f"of the {len(r)} that can be recomputed")


def _significantly_correlated(evidence: Evidence) -> Recomputed:
    """How many variables of Table 5.12 correlate with the quantity over all impacts, p below `ALPHA`."""
    r, n = evidence.correlations.values(), float(evidence.table["impacts"].sum())
    count = sum(p_value(value, n) < ALPHA for value in r)
    return Recomputed(float(count), note=f"of the {len(r)} that can be recomputed, at {ALPHA}")


def _in_final_model(evidence: Evidence) -> Recomputed:
    """How many variables of Table 5.17 forward selection enters."""
    stepwise = evidence.published.stepwise
    rows = stepwise[stepwise["quantity"] == evidence.quantity]
    entered = select_forward(evidence.table["average"], candidates(rows["variable"], evidence.table))
    printed = (rows["status"] == "entered").sum()
    note = f"without skin fold and muscle thickness; Table 5.17 enters {printed}"
    return Recomputed(float(len(entered)), note=note)


def _estimates(evidence: Evidence) -> Recomputed:
    """How many impacts were estimated."""
    left = f"{len(evidence.published.estimates)} of them remain"
    return Recomputed(float(evidence.table["impacts"].sum()), note=left)


def _available(evidence: Evidence) -> Recomputed:
    """How many variables Table 5.17 chooses among, equal products counted once."""
    names = evidence.published.stepwise["variable"]
    listed = f"Table 5.17 lists {names.nunique()} names, of which equal products are counted once"
    return Recomputed(float(names.map(factors).nunique()), note=listed)


_EXTREMES = {"minimum": smallest, "maximum": largest}
_STATISTICS: dict[str, Callable[[Evidence], Recomputed]] = {
    "mean": lambda evidence: Recomputed(grand_mean(evidence.table), evidence.rounding),
    "variance": _variance,
    "minimum": lambda evidence: evidence.end_of_impacts("minimum"),
    "maximum": lambda evidence: evidence.end_of_impacts("maximum"),
    "range": lambda evidence: _of_ends(difference, evidence.possible_end_of_impacts),
    "ratio of maximum to minimum": lambda evidence: _of_ends(ratio, evidence.possible_end_of_impacts),
    "minimum of trial averages": lambda evidence: evidence.end_of_averages("minimum"),
    "maximum of trial averages": lambda evidence: evidence.end_of_averages("maximum"),
    "range of trial averages": lambda evidence: _of_ends(difference, evidence.end_of_averages),
    "ratio of trial averages": lambda evidence: _of_ends(ratio, evidence.end_of_averages),
    "number of variables significantly correlated": _significantly_correlated,
    "number of variables in the final stepwise model": _in_final_model,
    "highest correlations with mass as a component": _with_mass_among_highest,
    "number of trials": lambda evidence: Recomputed(float(len(evidence.table))),
    "number of subjects": lambda evidence: Recomputed(
        float(evidence.published.estimates["subject"].nunique())
    ),
    "number of estimates": _estimates,
    "number of variables available to the stepwise analysis": _available,
}
_CORRELATION = re.compile(r"correlation (?P<averaged>of trial averages )?with (?P<name>.+)")
_NO_RULE = "no rule recomputes this statistic"


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
