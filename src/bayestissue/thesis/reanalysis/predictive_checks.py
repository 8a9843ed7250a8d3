"""Posterior predictive checks: statistics of replicates beside those of the data (Gelman et al. 1996)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

Statistic = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def predictive_checks(
    observed: np.ndarray, replicates: np.ndarray, trial: np.ndarray, mass_kg: np.ndarray
) -> pd.DataFrame:
    """Observed statistics of (log K, log C) beside their posterior predictive distribution.

    ``observed`` [impact, 2], ``replicates`` [replicate, impact, 2], ``trial`` and ``mass_kg`` [impact].
    ``p_value`` is the share of replicates at or above the observed statistic: near 0 or 1, the model does
    not make such data (Gelman, Meng and Stern 1996).
    """
    rows = []
    for column, quantity in enumerate("KC"):
        for name, statistic in _STATISTICS.items():
            own = float(statistic(observed[..., column], trial, mass_kg))
            made = statistic(replicates[..., column], trial, mass_kg)
            rows.append(_row(name, quantity, own, made))
    both_own = float(_correlation_within(observed, trial))
    rows.append(
        _row("correlation of K and C within trials", "K, C", both_own, _correlation_within(replicates, trial))
    )
    return pd.DataFrame(rows)


def _row(name: str, quantity: str, own: float, made: np.ndarray) -> dict[str, object]:
    low, median, high = np.quantile(made, [0.05, 0.5, 0.95])
    return {
        "statistic": name,
        "quantity": quantity,
        "observed": own,
        "predicted_median": float(median),
        "predicted_low": float(low),
        "predicted_high": float(high),
        "p_value": float(np.mean(made >= own)),
    }


def _within(logs: np.ndarray, trial: np.ndarray) -> np.ndarray:
    membership = trial[:, None] == np.unique(trial)
    means = (logs @ membership) / membership.sum(0)
    return logs - means @ membership.T


def _correlation_within(logs: np.ndarray, trial: np.ndarray) -> np.ndarray:
    K, C = _within(logs[..., 0], trial), _within(logs[..., 1], trial)
    return (K * C).mean(-1) / np.sqrt((K**2).mean(-1) * (C**2).mean(-1))


def _skewness_within(logs: np.ndarray, trial: np.ndarray, mass: np.ndarray) -> np.ndarray:
    deviation = _within(logs, trial)
    return (deviation**3).mean(-1) / (deviation**2).mean(-1) ** 1.5


def _light_to_heavy(logs: np.ndarray, trial: np.ndarray, mass: np.ndarray) -> np.ndarray:
    squares = _within(logs, trial) ** 2
    heavy = mass > np.median(mass)
    return np.sqrt(squares[..., ~heavy].mean(-1) / squares[..., heavy].mean(-1))


def _mass_correlation(logs: np.ndarray, trial: np.ndarray, mass: np.ndarray) -> np.ndarray:
    values, m = np.exp(logs), mass - mass.mean()
    centred = values - values.mean(-1, keepdims=True)
    return (centred @ m) / np.sqrt((centred**2).sum(-1) * (m @ m))


_STATISTICS: dict[str, Statistic] = {
    "smallest value": lambda logs, trial, mass: np.exp(logs.min(-1)),
    "largest value": lambda logs, trial, mass: np.exp(logs.max(-1)),
    "standard deviation of the log within trials": lambda logs, trial, mass: _within(logs, trial).std(-1),
    "skewness of the log within trials": _skewness_within,
    "scatter at light masses over scatter at heavy ones": _light_to_heavy,
    "correlation with mass": _mass_correlation,
}
