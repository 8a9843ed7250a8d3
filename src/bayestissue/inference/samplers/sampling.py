"""Draws of chains: as one array, their quantiles, importance weights, R-hat and effective sample sizes.

Weights are Pareto-smoothed (Vehtari et al. 2024); draws without weight may be among them. Split R-hat and
effective sample sizes (Vehtari et al. 2021, doi:10.1214/20-BA1221) are of many quantities at once. Their
numbers are those of ArviZ, which goes through the quantities one by one: twice as long for 4,000 draws, 26
times for the 80 that are kept of each of 100,000 impacts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from scipy import fft
from scipy.special import logsumexp, ndtri
from scipy.stats import rankdata

from bayestissue.inference.execution.compiling import in_parts

# Above it the error of a smoothed mean falls too slowly, however many draws there are.
GREATEST_K = 0.7
# What sorting and transforming them takes at once stays small, and in a processor's cache.
_AT_ONCE = 64
_FEWEST = 4
# What R-hat may be at most, that of a single impact, and the share of impacts of which it may be more.
R_HAT_LIMIT, ROUGH, _SHARE = 1.01, 1.05, 0.01
# The quantiles whose indicators the tail's sample size is of: ArviZ's own.
TAILS = (0.11, 0.89)

Draws = Float[np.ndarray, "quantity chain draw"]
Sizes = Float[np.ndarray, " quantity"]


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
    shape = [values.sizes[name] for name in values.dims if name not in drawn]
    flat = values.transpose(..., *drawn).to_numpy().reshape(math.prod(shape), -1)
    ends = quantiles(np.ascontiguousarray(flat), [0.05, 0.5, 0.95])
    names = (f"{name}_low", name, f"{name}_high") if name else ("low", "median", "high")
    # Of one value a number, and no array of one.
    return {which: end.reshape(shape)[()] for which, end in zip(names, ends, strict=True)}


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


class Convergence(NamedTuple):
    """How far the draws of each quantity can be relied on; NaN where a draw is none, or draws are too few.

    Infinite draws, of what never happens in them, count as greatest; their mean has no size.

    Attributes:
        r_hat: the greater of the rank-normalised split R-hats of the draws and of their distance from the
            median.
        ess_bulk: effective sample size of the rank-normalised draws.
        ess_tail: the lesser of those of the indicators of the quantiles `TAILS`.
        ess_mean: that of the draws themselves, whose mean has the standard error sd / ess_mean^1/2.
    """

    r_hat: Sizes
    ess_bulk: Sizes
    ess_tail: Sizes
    ess_mean: Sizes


def let_pass(r_hat: Sizes, limit: float = ROUGH) -> Bool[np.ndarray, " quantity"]:
    """Which of single impacts' values of R-hat end no run, and fail none.

    What the population's draws do not need, no impact holds up: R-hat may be as great as the limit, and
    greater in one impact of a hundred. All are greatest where it is open.
    """
    beyond = r_hat > limit
    return ~beyond | (beyond.sum() <= _SHARE * len(r_hat))


def convergence(draws: Draws) -> Convergence:
    """R-hat and effective sample sizes of each quantity."""
    if not len(draws):
        return Convergence(*[np.zeros(0)] * len(Convergence._fields))
    return Convergence(*in_parts(_of_some, (draws,), _AT_ONCE))


def effective_size(draws: Draws) -> Sizes:
    """Effective sample size of each quantity's mean: `Convergence.ess_mean` alone."""
    return np.asarray(in_parts(_size_of_mean, (draws,), _AT_ONCE))


def elements_of(array: xr.DataArray) -> Draws:
    """Draws of each element of a variable, along one axis."""
    draws = array.transpose(..., "chain", "draw").to_numpy().astype(float)
    return draws.reshape(-1, *draws.shape[-2:])


def _of_some(draws: Draws) -> list[Sizes]:
    if draws.shape[2] < _FEWEST:
        return [np.full(len(draws), np.nan)] * len(Convergence._fields)
    # Of many impacts they are of single precision.
    draws = np.asarray(draws, float)
    of_mean, infinite = _size_of_mean(draws), np.isinf(draws)
    draws = _ranked_last(draws, infinite) if infinite.any() else draws
    split = _split(draws)
    median = np.median(split, axis=(1, 2), keepdims=True)
    bulk, folded = _normal_scores(split), _normal_scores(np.abs(split - median))
    ends = np.quantile(draws, TAILS, axis=(1, 2), keepdims=True)
    tails = [_size(_split((draws <= end).astype(float))) for end in ends]
    sizes = (np.fmax(_r_hat(bulk), _r_hat(folded)), _size(bulk), np.minimum(*tails), of_mean)
    known = ~np.isnan(draws).any(axis=(1, 2))
    compared = known & (draws.shape[1] > 1)
    return [np.where(compared if n == 0 else known, size, np.nan) for n, size in enumerate(sizes)]


def _ranked_last(draws: Draws, infinite: Bool[np.ndarray, "quantity chain draw"]) -> Draws:
    """Infinite draws as one number above, or below, all others: ranks are all that is asked of them."""
    others = np.where(infinite, 0.0, draws)
    beyond = 1 + 3 * np.abs(others).max(axis=(1, 2), keepdims=True)
    return np.where(infinite, np.sign(draws) * beyond, draws)


def _size_of_mean(draws: Draws) -> Sizes:
    if draws.shape[2] < _FEWEST:
        return np.full(len(draws), np.nan)
    # A quantity that is infinite in a draw, as a contact that never ends, has no mean.
    finite = np.isfinite(draws).all(axis=(1, 2))
    return np.where(finite, _size(_split(np.where(finite[:, None, None], draws, 0.0))), np.nan)


def _split(draws: Draws) -> Draws:
    """Each chain as two, the first and the last half of its draws."""
    half = draws.shape[2] // 2
    return np.concatenate([draws[..., :half], draws[..., -half:]], axis=1)


def _normal_scores(draws: Draws) -> Draws:
    """Normal quantiles at (rank - 3/8) / (S + 1/4), draws of one value sharing their mean rank."""
    ranks = rankdata(draws.reshape(len(draws), -1), axis=1)
    return ndtri((ranks - 3 / 8) / (ranks.shape[1] + 1 / 4)).reshape(draws.shape)


def _r_hat(draws: Draws) -> Sizes:
    """((B / W + n - 1) / n)^1/2 with the variances B between and W within chains of n draws."""
    n = draws.shape[2]
    between, within = n * draws.mean(2).var(1, ddof=1), draws.var(2, ddof=1).mean(1)
    # What is the same in every draw has no R-hat.
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt((between / within + n - 1) / n)


def _size(draws: Draws) -> Sizes:
    """S / (-1 + 2 sum_t rho_t), summed by Geyer's initial monotone sequence.

    Sums of the autocorrelations rho_t of neighbouring lags, 2k and 2k + 1, are positive and fall with k.
    They count as long as that is so, each as the least before it where it rises again; the even lag after
    them counts once.
    """
    chains, n = draws.shape[1:]
    covariance = _autocovariance(draws)
    within = covariance[:, :1] * n / (n - 1)
    total = covariance[:, :1] + (draws.mean(2).var(1, ddof=1)[:, None] if chains > 1 else 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = 1 - (within - covariance) / total
    rho[:, 0] = 1.0
    most = max((n - 3) // 2, 0)
    even, odd = rho[:, : 2 * most + 1 : 2], rho[:, 1 : 2 * most + 2 : 2]
    pairs = even + odd
    over = np.concatenate([pairs[:, :-1] <= 0, np.ones((len(pairs), 1), bool)], axis=1)
    count = np.argmax(over, axis=1)
    falling = np.minimum.accumulate(pairs, axis=1)
    summed = np.where(np.arange(most + 1) < count[:, None], falling, 0.0).sum(1)
    last, together = (np.take_along_axis(values, count[:, None], 1)[:, 0] for values in (even, pairs))
    size = chains * n
    lags = -1 + 2 * summed + np.where((last > 0) | (together >= 0), last, 0.0)
    effective = size / np.maximum(lags, 1 / np.log10(size))
    still = np.ptp(draws, axis=(1, 2)) < np.finfo(float).resolution
    return np.where(still, float(size), effective)


def _autocovariance(draws: Draws) -> Float[np.ndarray, "quantity lag"]:
    """Of all lags, divided by the number of draws, the mean over the chains."""
    n = draws.shape[2]
    length = fft.next_fast_len(2 * n, real=True)
    spectrum = fft.rfft(draws - draws.mean(2, keepdims=True), length, axis=2)
    power = (spectrum.real**2 + spectrum.imag**2).mean(1)
    return np.asarray(fft.irfft(power, length, axis=1)[:, :n] / n)
