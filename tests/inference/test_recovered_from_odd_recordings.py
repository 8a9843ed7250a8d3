"""K and C of single impacts with uneven times or with the peak cut off: unbiased, in intervals that hold."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import bayestissue as bt

COUNT, MASS, VELOCITY, STEP = 100, 0.5, 1.5, 5e-4
pytestmark = pytest.mark.long


def made(
    *, jitter: float = 0.0, lost: float = 0.0, share: float = 1.0, C: float = 25.0
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Impacts at 2 kHz in 1 % of noise, contact between two samples: the truth and the recordings."""
    random = np.random.default_rng(5)
    truth, traces = [], []
    for _ in range(COUNT):
        K, damping = 3000 * np.exp(0.2 * random.standard_normal()), C * np.exp(0.2 * random.standard_normal())
        time = np.arange(0, 0.08, STEP)
        time = time + jitter * STEP * random.standard_normal(len(time)).clip(-2.5, 2.5)
        time = np.sort(time[random.random(len(time)) >= lost])
        since = time - 0.03 - STEP * random.random()
        omega, zeta = np.sqrt(K / MASS), damping / (2 * np.sqrt(K * MASS))
        turn, on = omega * np.sqrt(1 - zeta**2), np.maximum(since, 0)
        decay = VELOCITY * np.exp(-zeta * omega * on)
        x = decay * np.sin(turn * on) / turn
        v = decay * (np.cos(turn * on) - zeta * omega / turn * np.sin(turn * on))
        d = np.where(since > 0, (K * x + damping * v) / MASS, 0.0)
        left = np.flatnonzero((since > 0) & (d <= 0))
        d[left[0] if len(left) else len(d) :] = 0.0
        d = d + 0.01 * d.max() * random.standard_normal(len(d))
        truth.append((K, damping))
        traces.append((time, np.minimum(d, share * d.max())))
    return np.array(truth), traces


@pytest.mark.parametrize(
    "spoilt",
    [{"jitter": 0.15, "lost": 0.01}, {"share": 0.8}, {"share": 0.6}, {"share": 0.8, "C": 10.0}],
)
def test_intervals_hold_and_medians_are_unbiased(spoilt: dict[str, float]) -> None:
    truth, traces = made(**spoilt)
    impacts = pd.DataFrame({"impact": [f"i{row}" for row in range(COUNT)], "subject": "s", "trial": "t"})
    impacts = impacts.assign(mass_kg=MASS, velocity_m_s=VELOCITY)
    table = bt.estimate(bt.dataset(impacts, traces, quantity="deceleration", unit="m/s^2"))
    for column, unit, values in (("K", "N_per_m", truth[:, 0]), ("C", "N_s_per_m", truth[:, 1])):
        found, low, high = (table[f"{column}{end}_{unit}"].to_numpy() for end in ("", "_low", "_high"))
        error = np.log(found / values)
        assert abs(error.mean()) < 3.5 * error.std() / np.sqrt(COUNT)
        # 90 % within three standard errors of the share.
        assert np.mean((low <= values) & (values <= high)) >= 0.81
