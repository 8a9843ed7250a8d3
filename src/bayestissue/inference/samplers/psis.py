"""Importance weights: Pareto smoothing (Vehtari et al. 2024), draws without weight among them, resampling."""

from __future__ import annotations

import numpy as np
from jax import Array
from jaxtyping import Float, Int
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


def effective_size(weight: Float[np.ndarray, "draw ..."]) -> Float[np.ndarray, " ..."]:
    """Effective sample size (sum w)^2 / sum w^2 of weights along a first axis; 0 where none is positive."""
    square = np.maximum(np.square(weight).sum(0), np.finfo(float).tiny)
    return np.asarray(weight.sum(0) ** 2 / square)


def below_greatest(log_weight: np.ndarray) -> np.ndarray:
    """Log weights along a first axis less the greatest of them; minus infinity where there is no weight."""
    most = log_weight.max(0)
    return log_weight - np.where(np.isfinite(most), most, 0.0)


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


def relative_variance(log_weight: np.ndarray | Array) -> np.ndarray:
    """Variance over mean squared of weights along the first axis; infinite where none has any weight."""
    weight = np.exp(below_greatest(np.asarray(log_weight)))
    mean = weight.mean(0)
    return np.where(mean > 0, weight.var(0) / np.where(mean > 0, mean, 1.0) ** 2, np.inf)


def systematic(
    weight: Float[np.ndarray, "chain transition"], number: int, rng: np.random.Generator
) -> Int[np.ndarray, "chain number"]:
    """Systematic resampling (Kitagawa 1996): transitions of each chain, as often as their weights say.

    Of N transitions with weights w the i-th is taken floor or ceil(number w_i / sum w) times, in its order.
    Chains are resampled apart, so that R-hat still compares them; one without any weight stays as it is.

    Args:
        weight: not negative, up to a constant.
        number: how many transitions of each chain.
        rng: makes one offset of each chain.
    """
    weight = np.where(weight.sum(axis=1, keepdims=True) > 0, weight, 1.0)
    reached = np.cumsum(weight / weight.sum(axis=1, keepdims=True), axis=1)
    position = (np.arange(number) + rng.uniform(size=(len(weight), 1))) / number
    chosen = [np.searchsorted(*pair) for pair in zip(reached, position, strict=True)]
    return np.minimum(chosen, weight.shape[1] - 1)
