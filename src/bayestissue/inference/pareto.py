"""Importance weights whose tail is looked at before they are used."""

from __future__ import annotations

import numpy as np


def pareto_smoothed(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Log importance weights with their greatest smoothed, and the Pareto k of these (Vehtari et al. 2024).

    Args:
        log_weight: [draw].
    """
    from arviz_stats.base import array_stats

    # The library takes log likelihoods to leave out, whose weights are their inverses.
    smoothed, k = array_stats.psislw(-np.asarray(log_weight))
    return np.asarray(smoothed), float(k)
