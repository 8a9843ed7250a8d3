"""What the tables say of one quantity: every statistic that the running text claims."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from bayestissue.dataset.published import PublishedTables
from bayestissue.thesis.reproduction.agreement import Recomputed
from bayestissue.thesis.reproduction.conditions import (
    Quantity,
    between_sum_of_squares,
    conditions,
    grand_mean,
    rounding_norm,
    within_sum_of_squares,
)
from bayestissue.thesis.reproduction.correlations import (
    correlation_of_averages,
    correlation_of_impacts,
    p_value,
)
from bayestissue.thesis.reproduction.covariates import covariate, has_mass
from bayestissue.thesis.reproduction.extremes import Extreme, largest, smallest
from bayestissue.thesis.reproduction.regressions import ALPHA, candidates, select_forward


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
    def _variables(self) -> list[str]:
        rows = self.published.correlations
        return [
            name
            for name in rows.loc[rows["table"] == "5.12", "variable"]
            if covariate(name, self.table) is not None
        ]

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
        order = sorted(
            self._variables, key=lambda name: -abs(_value(correlation_of_impacts(name, self.table)))
        )
        leading = np.cumprod([has_mass(name) for name in order])
        return Recomputed(float(leading.sum()), note=f"of the {len(order)} that can be recomputed")

    def significantly_correlated(self) -> Recomputed:
        """How many variables of Table 5.12 correlate with the quantity over all impacts, p below `ALPHA`."""
        n = float(self.table["impacts"].sum())
        found = [p_value(_value(correlation_of_impacts(name, self.table)), n) for name in self._variables]
        count = sum(p < ALPHA for p in found)
        return Recomputed(float(count), note=f"of the {len(found)} that can be recomputed, at {ALPHA}")

    def in_final_model(self) -> Recomputed:
        """How many variables of Table 5.17 forward selection enters."""
        rows = self.published.stepwise.query("quantity == @self.quantity")
        entered = select_forward(self.table["average"], candidates(rows["variable"], self.table))
        printed = (rows["status"] == "entered").sum()
        return Recomputed(
            float(len(entered)), note=f"without skin fold and muscle thickness; Table 5.17 enters {printed}"
        )

    def correlation(self, name: str) -> Recomputed:
        """`correlation_of_impacts` with the variable ``name``."""
        return correlation_of_impacts(name, self.table)

    def averaged_correlation(self, name: str) -> Recomputed:
        """`correlation_of_averages` with the variable ``name``."""
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


def _value(found: Recomputed) -> float:
    return float("nan") if found.value is None else found.value
