"""Importance weights: Pareto smoothing (Vehtari et al. 2024), draws without weight among them."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

# Above it the error of a smoothed mean falls too slowly, however many draws there are.
GREATEST_K = 0.7


def k_threshold(draws: int) -> float:
    """Pareto k up to which importance weights of S draws can be trusted: min(1 - 1 / log10 S, 0.7).

    Vehtari et al. 2024, section 3.2.4: of a few hundred draws the tail is too short for k = 0.7.

    Args:
        draws: S, how many weights there are.
    """
    return float(min(1 - 1 / np.log10(max(draws, 10)), GREATEST_K))


def pareto_smoothed(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Log importance weights with their greatest smoothed, and the Pareto k of these (Vehtari et al. 2024).

    Where no draw has any weight, or a draw or two have all, they are left as they are, and k is infinite:
    nothing vouches for them.

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
    # Weights of some hundred nats leave the library's fit of their tail without numbers.
    with np.errstate(all="ignore"):
        smoothed[has], k = array_stats.psislw(-log_weight[has])
    if np.isnan(smoothed).any() or np.isnan(k):
        return np.where(has, log_weight, -np.inf) - logsumexp(log_weight[has]), np.inf
    return smoothed, float(k)
