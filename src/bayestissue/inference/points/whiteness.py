"""Whether residuals are white: their autocorrelations, and Ljung and Box's portmanteau test."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Num
from scipy.special import chdtrc

LAGS = 10
Column = Float[np.ndarray, " impact"]
Count = Num[np.ndarray, " impact"]
Rows = Float[np.ndarray, "impact sample"]


def whiteness(x: Rows, n_samples: Count, c1: Column, c2: Column, theta1: Column) -> Column:
    """p-value of Ljung and Box's test of a fit's residuals: see `ljung_box`.

    theta1 spends one degree of freedom; c1 and c2 belong to a signal far above the noise and spend none.
    The residuals are the standardised one-step prediction errors, which are white at |theta1| = 1 too.

    Args:
        x: displacements about the fit's equilibrium [m], padded.
        n_samples: length of each.
        c1: 2 - phi1.
        c2: 1 - phi1 - phi2.
        theta1: moving-average coefficient.

    Returns:
        p-values; NaN where an impact has fewer than 20 residuals.
    """
    shocks = residuals(x, n_samples, c1, c2, theta1)
    return ljung_box(shocks, np.asarray(n_samples) - 2, spent=1)


def ljung_box(shocks: Float[np.ndarray, "residual impact"], size: Count, spent: int = 0) -> Column:
    """p-value of Ljung and Box's statistic n (n + 2) sum_k r_k^2 / (n - k) over ten lags.

    With the autocorrelations r_k; chi-squared with as many degrees of freedom as there are lags, less the
    parameters ``spent`` on the fit (Ljung and Box 1978, doi:10.1093/biomet/65.2.297).

    Args:
        shocks: about their mean, 0 past the end.
        size: n of each impact.
        spent: number of parameters.

    Returns:
        p-values; NaN where an impact has fewer than 20 residuals.
    """
    square = np.einsum("ti,ti->i", shocks, shocks)
    statistic = np.zeros(shocks.shape[1])
    for lag in range(1, min(LAGS, len(shocks) - 1) + 1):
        with np.errstate(invalid="ignore", divide="ignore"):
            r = np.einsum("ti,ti->i", shocks[lag:], shocks[:-lag]) / square
        statistic += r**2 / np.maximum(size - lag, 1)
    return np.where(size >= 2 * LAGS, chdtrc(LAGS - spent, size * (size + 2) * statistic), np.nan)


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


def residuals(
    x: Rows, n_samples: Count, c1: Column, c2: Column, theta1: Column
) -> Float[np.ndarray, "residual impact"]:
    """v_t / sqrt(r_t) with v_t = w_t + theta1 v_{t-1} / r_{t-1}, r_t = 1 + theta1^2 - theta1^2 / r_{t-1}.

    Time runs along the first axis, so that each step is one operation over all impacts; 0 past the end.
    Arguments as for `whiteness`.
    """
    series = np.ascontiguousarray(x.T)
    slope = np.diff(series, axis=0)
    w = np.diff(slope, axis=0) + c1 * slope[:-1] + c2 * series[:-2]
    size = np.asarray(n_samples) - 2
    error, one_over, square = np.zeros_like(c1), np.zeros_like(c1), theta1**2
    for t, now in enumerate(w):
        r = 1 + square * (1 - one_over)
        v = now + theta1 * error
        w[t], error, one_over = v / np.sqrt(r), v / r, 1 / r
    return np.where(np.arange(len(w))[:, None] < size, w, 0.0)
