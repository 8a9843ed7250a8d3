"""Draws of chains as one array after the other, their quantiles, and importance weights of draws.

Weights are Pareto-smoothed (Vehtari et al. 2024); draws without weight may be among them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.special import logsumexp

# Above it the error of a smoothed mean falls too slowly, however many draws there are.
GREATEST_K = 0.7


def flat(draws: Any) -> Any:
    """Arrays [chain, draw, ...] as [draw, ...], one chain's draws after the other's."""
    return jax.tree.map(lambda values: values.reshape(-1, *values.shape[2:]), draws)


def in_chains(draws: Any, shape: tuple[int, int]) -> Any:
    """The reverse of `flat`, of so many chains and draws of each."""
    return jax.tree.map(lambda values: np.asarray(values).reshape(*shape, *values.shape[1:]), draws)


def quantiles(
    draws: Float[np.ndarray, "quantity draw"],
    probabilities: Sequence[float],
    method: Literal["linear", "weibull"] = "linear",
) -> Float[np.ndarray, "probability quantity"]:
    """Quantiles of each quantity; where it is infinite in some draws, each is one of them.

    A quantity is infinite where what it is the time of never happens. Between a number and infinity there is
    nothing to interpolate.
    """
    with np.errstate(invalid="ignore"):
        between = np.quantile(draws, probabilities, axis=1, method=method)
    never = np.isinf(draws).any(axis=1)
    if never.any():
        between[:, never] = np.quantile(draws[never], probabilities, axis=1, method="inverted_cdf")
    return between


def weighted_quantiles(
    values: Float[np.ndarray, "quantity draw"],
    weights: Float[np.ndarray, "quantity draw"],
    probabilities: Sequence[float],
) -> list[Float[np.ndarray, " quantity"]]:
    """Quantiles of each quantity's weighted draws, linear between the middles of the weights."""
    order = np.argsort(values, axis=1)
    ordered, weight = (np.take_along_axis(part, order, axis=1) for part in (values, weights))
    below = np.cumsum(weight, axis=1) - weight / 2
    return [
        np.array([np.interp(p, x, y) for x, y in zip(below, ordered, strict=True)]) for p in probabilities
    ]


def interval(values: xr.DataArray, name: str = "") -> dict[str, np.ndarray]:
    """Median and ends of the 90 % equal-tailed interval over all draws, as `quantiles` has them.

    Returns:
        ``low``, ``median`` and ``high``, by a ``name`` such as "rank" ``rank_low``, ``rank``, ``rank_high``,
        each by what dimensions the values have besides.
    """
    drawn = [name for name in values.dims if name in ("chain", "draw", "kept_draw")]
    rest = [values.sizes[name] for name in values.dims if name not in drawn]
    flat = values.transpose(..., *drawn).to_numpy().reshape(math.prod(rest), -1)
    ends = quantiles(np.ascontiguousarray(flat), [0.05, 0.5, 0.95])
    names = (f"{name}_low", name, f"{name}_high") if name else ("low", "median", "high")
    # Of one value a number, and no array of one.
    return {which: end.reshape(rest)[()] for which, end in zip(names, ends, strict=True)}


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
