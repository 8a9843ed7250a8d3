"""The smallest and the largest of all impacts, as far as the impacts that remain decide them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd


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
