"""Split R-hat and effective sample sizes of many quantities at once (Vehtari et al. 2021).

doi:10.1214/20-BA1221. The numbers are those of ArviZ, which goes through the quantities one by one: twice as
long for 4,000 draws, 26 times for the 80 that are kept of each of 100,000 impacts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from scipy import fft
from scipy.special import ndtri
from scipy.stats import rankdata

from bayestissue.inference.execution.compiling import in_parts

# What sorting and transforming them takes at once stays small, and in a processor's cache.
_AT_ONCE = 64
_FEWEST = 4
# What R-hat of a single impact may be, and the share of impacts of which it may be more.
ROUGH, _SHARE = 1.05, 0.01
# The quantiles whose indicators the tail's sample size is of: ArviZ's own.
TAILS = (0.11, 0.89)

Draws = Float[np.ndarray, "quantity chain draw"]
Sizes = Float[np.ndarray, " quantity"]


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
