"""Importance weights: those of points without any likelihood among them, and a look at their tail."""

from __future__ import annotations

import numpy as np


def below_greatest(log_weight: np.ndarray) -> np.ndarray:
    """Log weights along a first axis less the greatest of them; minus infinity where there is no weight."""
    most = log_weight.max(0)
    return log_weight - np.where(np.isfinite(most), most, 0.0)


def pareto_smoothed(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Log importance weights with their greatest smoothed, and the Pareto k of these (Vehtari et al. 2024).

    Where no draw has any weight they are left as they are, and k is infinite: nothing vouches for them.

    Args:
        log_weight: [draw]; minus infinity, or no number, for a draw without weight.

    Returns:
        Log weights that sum to 1, and k.
    """
    from arviz_stats.base import array_stats

    log_weight = np.asarray(log_weight)
    has = np.isfinite(log_weight)
    if not has.any():
        return np.full(log_weight.shape, -np.log(log_weight.size)), np.inf
    # The library takes log likelihoods to leave out, whose weights are their inverses, and knows no infinity.
    smoothed = np.full(log_weight.shape, -np.inf)
    smoothed[has], k = array_stats.psislw(-log_weight[has])
    return smoothed, float(k)
