"""Whether residuals are white: their autocorrelations, and portmanteau tests of these."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Num

from bayestissue.base.impact_arrays import PerImpact
from bayestissue.inference.execution.compiling import in_parts

LAGS = 10
# Of a matrix of cosines between columns, over their number: directions that rounding alone tells apart.
_ALIKE = 1e-11
# Second degrees of freedom of the statistic's F, by slope and constant.
_SECOND = (0.55, 10.0)
# In memory at once.
_MOST_NUMBERS = 20_000_000
Count = Num[np.ndarray, " impact"]


def projected_portmanteau(
    shocks: Float[np.ndarray, "impact shock"], fitted: Float[np.ndarray, "impact column shock"], size: Count
) -> PerImpact:
    """p-value of the autocorrelations of white noise at ten lags, once columns are taken off it.

    Whatever was fitted to a trace takes its directions off the noise, which is white no longer: with M the
    projection onto what is left, of rank v, and S_k the symmetric shift by k samples, the autocorrelations
    r_k = z' M S_k M z / z' M z of white normal z have the mean tr(S_k M) / v and
    E r_k r_l = (tr(S_k M) tr(S_l M) + 2 tr(S_k M S_l M)) / (v (v + 2)), since z' M z is independent of them.
    The statistic is their squared distance from that mean under that covariance. Its mean is 10; of long
    series it is Ljung and Box's, chi-squared. Of short ones its tail is longer: it is taken for a scaled F
    with 10 and 0.55 v + 10 degrees of freedom and the same mean. Of simulated noise less five to twenty
    smooth columns, 26 to 400 samples long, 0.8 to 1.4 % had p below 0.01 (chi-squared: 1.2 to 2.7 %).

    Args:
        shocks: residuals, 0 past the end.
        fitted: what a unit of each fitted quantity adds to them, 0 past the end; a column of zeros is none.
        size: number of residuals of each impact.

    Returns:
        p-values; NaN where fewer than 20 directions are left.
    """
    _, columns, width = fitted.shape
    per_part = max(1, _MOST_NUMBERS // max(1, LAGS * columns * width))
    return np.asarray(in_parts(_projected, (shocks, fitted, size), per_part))


def _projected(shocks: np.ndarray, fitted: np.ndarray, size: np.ndarray) -> PerImpact:
    from scipy.special import fdtrc

    lags = range(1, min(LAGS, shocks.shape[1] - 1) + 1)
    inside = np.arange(shocks.shape[1]) < size[:, None]
    basis, rank = _orthonormal(np.where(inside[:, None], fitted, 0.0))
    left = shocks - np.einsum("ikt,ik->it", basis, np.einsum("ikt,it->ik", basis, shocks))
    freedom = size - rank
    enough = (freedom >= 2 * LAGS) & (np.square(left).sum(1) > 0)
    # Those that are too short are asked for nothing; a rank of 20 leaves their formulas finite.
    freedom = np.where(enough, freedom, 2 * LAGS)
    r = np.stack([(left[:, lag:] * left[:, :-lag]).sum(1) for lag in lags], axis=1)
    r /= np.where(enough, np.square(left).sum(1), 1.0)[:, None]
    shifted = np.stack([_shifted(basis, lag) for lag in lags], axis=1) * inside[:, None, None]
    within = np.einsum("ilat,ibt->ilab", shifted, basis, optimize=True)
    trace = -np.einsum("ilaa->il", within)
    flat = shifted.reshape(*shifted.shape[:2], -1)
    twice = np.einsum("ilab,imab->ilm", within, within) - 2 * flat @ flat.swapaxes(1, 2)
    twice += np.eye(len(lags)) * (np.maximum(size[:, None] - np.array(lags), 0) / 2)[:, None]
    product = trace[:, :, None] * trace[:, None] + 2 * twice
    mean = trace / freedom[:, None]
    spread = product / (freedom * (freedom + 2))[:, None, None] - mean[:, :, None] * mean[:, None]
    spread = np.where(enough[:, None, None], spread, np.eye(len(lags)))
    deviation = r - mean
    distance = np.einsum("il,il->i", deviation, np.linalg.solve(spread, deviation[..., None])[..., 0])
    second = _SECOND[0] * freedom + _SECOND[1]
    return np.where(enough, fdtrc(len(lags), second, distance / len(lags) * second / (second - 2)), np.nan)


def _orthonormal(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An orthonormal basis of each impact's columns, zeros where it has fewer, and how many it has."""
    length = np.sqrt(np.square(columns).sum(-1, keepdims=True))
    columns = columns / np.where(length > 0, length, 1.0)
    values, axes = np.linalg.eigh(columns @ columns.swapaxes(1, 2))
    counts = values > _ALIKE * columns.shape[1]
    axes = axes / np.sqrt(np.where(counts, values, np.inf))[:, None]
    return axes.swapaxes(1, 2) @ columns, counts.sum(1)


def _shifted(basis: np.ndarray, lag: int) -> np.ndarray:
    """Half of each row shifted by ``lag`` one way and half the other, 0 from beyond its ends."""
    shifted = np.zeros_like(basis)
    shifted[..., lag:] += basis[..., :-lag] / 2
    shifted[..., :-lag] += basis[..., lag:] / 2
    return shifted


def autocorrelation(
    values: Float[np.ndarray, "*draw impact sample"],
    used: Bool[np.ndarray, "impact sample"],
    *,
    powers: int,
    lags: int,
) -> Float[np.ndarray, "*draw impact"]:
    """The autocorrelations of each row at the first ``lags``, added up, a polynomial in time taken off it.

    Errors of a measuring chain are as smooth as a polynomial; what is left of residuals is noise, or the mark
    of another law.

    Args:
        values: residuals; NaN where they are not ``used``.
        used: whether there is a sample.
        powers: of time in the polynomial: 3 of a parabola.
        lags: how many.
    """
    values = np.where(used, values, 0.0)
    time = np.linspace(-1, 1, used.shape[-1])
    smooth = np.linalg.qr(np.where(used[..., None], time[:, None] ** np.arange(powers), 0.0)).Q
    values = values - np.einsum("...isk,...ik->...is", smooth, np.einsum("...is,isk->...ik", values, smooth))
    products = sum((values[..., lag:] * values[..., :-lag]).sum(-1) for lag in range(1, lags + 1))
    return products / (values**2).sum(-1)
