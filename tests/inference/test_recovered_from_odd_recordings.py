"""K and C of single impacts with uneven times or with the peak cut off: unbiased, in intervals that hold."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt
from campaigns import COLUMNS, binomial, holds
from dataset_bench import closed_form

COUNT, MASS, VELOCITY, STEP = 100, 0.5, 1.5, 5e-4
pytestmark = pytest.mark.long


def made(
    *, jitter: float = 0.0, lost: float = 0.0, share: float = 1.0, C: float = 25.0
) -> tuple[pd.DataFrame, list[tuple[np.ndarray, np.ndarray]]]:
    """Impacts at 2 kHz in 1 % of noise, contact between two samples: the truth and the recordings."""
    random = np.random.default_rng(5)
    truth, traces = [], []
    for _ in range(COUNT):
        K, damping = 3000 * np.exp(0.2 * random.standard_normal()), C * np.exp(0.2 * random.standard_normal())
        time = np.arange(0, 0.08, STEP)
        time = time + jitter * STEP * random.standard_normal(len(time)).clip(-2.5, 2.5)
        time = np.sort(time[random.random(len(time)) >= lost])
        since = time - 0.03 - STEP * random.random()
        d = closed_form(since, MASS, VELOCITY, K, damping)
        left = np.flatnonzero((since > 0) & (d <= 0))
        d[left[0] if len(left) else len(d) :] = 0.0
        d = d + 0.01 * d.max() * random.standard_normal(len(d))
        truth.append(dict(zip(COLUMNS.values(), (K, damping), strict=True)))
        traces.append((time, np.minimum(d, share * d.max())))
    return pd.DataFrame(truth), traces


@pytest.mark.parametrize(
    "spoilt",
    [{"jitter": 0.15, "lost": 0.01}, {"share": 0.8}, {"share": 0.6}, {"share": 0.8, "C": 10.0}],
)
def test_intervals_hold_and_medians_are_unbiased(spoilt: dict[str, float]) -> None:
    truth, traces = made(**spoilt)
    impacts = pd.DataFrame({"impact": [f"i{row}" for row in range(COUNT)], "subject": "s", "trial": "t"})
    impacts = impacts.assign(mass_kg=MASS, velocity_m_s=VELOCITY)
    table = bt.estimate(bt.dataset(impacts, traces, quantity="deceleration", unit="m/s^2"))
    error = np.log(table[[*truth]] / truth)
    assert (error.mean().abs() < 3.5 * error.std() / np.sqrt(COUNT)).all()
    holds(table, truth, least=0.9 - binomial(COUNT))
