"""What K, C and their intervals may not depend on: units, clocks, names, the order and company of impacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import bayestissue as bt
from bayestissue.recordings.dataset import Trace
from campaigns import simulated, spreads

pytestmark = pytest.mark.slow

RECORDING = {"sampling_rate_hz": 2000.0, "noise_relative_to_peak": 0.01, "velocity_sd_m_s": 0.01}
# Of K and C: rounding errors of samples, carried through a search that ends at steps of 1e-9.
ALIKE = 1e-6
NUMBERS = [
    *("K_N_per_m", "K_low_N_per_m", "K_high_N_per_m", "C_N_s_per_m", "C_low_N_s_per_m", "C_high_N_s_per_m"),
    *("peak_force_N", "peak_force_low_N", "peak_depth_m"),
]


class Recorded:
    """Tables of a campaign, from which variants are made."""

    def __init__(self) -> None:
        made = simulated(spreads(subject=0.3), RECORDING, people=4, masses=(0.4, 1.0)).dataset("x")
        self.uncertainty = made.uncertainty
        self.impacts = made.impacts.drop(columns="sampling_rate_hz")
        self.traces = [(np.asarray(trace.time_s), np.asarray(trace.value)) for trace in made.traces]

    def estimates(
        self, rows: Any = slice(None), *, unit: str = "m/s^2", time_unit: str = "s", **change: Any
    ) -> pd.DataFrame:
        """Numbers by impact of these rows, recorded in other units, or with columns or clocks changed."""
        size, length = {"m/s^2": 1.0, "g_0": 1 / 9.80665}[unit], {"s": 1.0, "ms": 1e3}[time_unit]
        clocks = change.pop("clocks", np.zeros(len(self.impacts)))
        numbers = np.arange(len(self.impacts))[rows]
        table = self.impacts.assign(**change).iloc[numbers].reset_index(drop=True)
        traces = [
            Trace(length * (self.traces[number][0] + clocks[number]), size * self.traces[number][1])
            for number in numbers
        ]
        settings = {"unit": unit, "time_unit": time_unit, "contact": "between"}
        data = bt.dataset(table, traces, quantity="deceleration", uncertainty=self.uncertainty, **settings)
        found = bt.estimate(data)
        return found[NUMBERS].set_axis(numbers).sort_index()


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return Recorded()


@pytest.fixture(scope="module")
def plain(recorded: Recorded) -> pd.DataFrame:
    return recorded.estimates()


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"rows": [5, 0, 7, 2, 1, 6, 3, 4]}, id="order"),
        pytest.param({"unit": "g_0", "time_unit": "ms"}, id="units"),
        pytest.param({"clocks": 12.345 + 0.1 * np.arange(8)}, id="clock"),
        pytest.param({"impact": list("hgfedcba"), "subject": list("wwxxyyzz")}, id="names"),
    ],
)
def test_estimates_are_the_same(recorded: Recorded, plain: pd.DataFrame, change: dict[str, Any]) -> None:
    assert_allclose(recorded.estimates(**change), plain, rtol=ALIKE)


def test_a_study_split_in_two_has_the_same_estimates(recorded: Recorded, plain: pd.DataFrame) -> None:
    halves = [recorded.estimates(rows) for rows in ([0, 2, 5, 6], [1, 3, 4, 7])]
    assert_allclose(pd.concat(halves).sort_index(), plain, rtol=ALIKE)
