"""Exact maximum likelihood of an ARMA(2,1) about the rest position, and its information."""

from __future__ import annotations

from functools import partial

import jax.numpy as jnp
from jax import Array

from bayestissue.inference.points.profile import (
    Columns,
    Covariance,
    Moments,
    Profile,
    invert,
    profile_fit,
)
from bayestissue.likelihood.quadratic import eigenvalues, log_determinant, sums_over_frequencies
from bayestissue.likelihood.transforms import SineTransforms


def fit_exact(data: SineTransforms) -> tuple[Profile, Covariance]:
    """The maximum of the exact likelihood with a free start, and the covariance of its coefficients.

    The covariance is the inverse of the observed information with sigma_a profiled out and the shock
    variance taken over N - 3 degrees of freedom. Where theta1 lies on its boundary, or its curvature has
    the wrong sign, the covariance is that of (c1, c2) at this theta1, and theta1 has none.
    """
    columns = (data.columns[0], data.columns[1], data.columns[2])
    fit = profile_fit(
        columns,
        data.size,
        partial(_moments, spread=data.spread),
        lambda theta1: log_determinant(theta1, data.size),
        lambda c, c1, c2: c[0] + c1[:, None] * c[1] + c2[:, None] * c[2],
    )
    return fit, _covariance(fit, columns, data)


def _moments(columns: Columns, theta1: Array, *, spread: Array) -> Moments:
    y0, y1, y2 = columns
    over = 1 / eigenvalues(theta1[:, None], spread)
    z0, z1 = y0 * over, y1 * over
    return Moments(*sums_over_frequencies((y0 * z0, y1 * z0, y2 * z0, y1 * z1, y2 * z1, y2 * y2 * over)))


def _covariance(fit: Profile, columns: Columns, data: SineTransforms) -> Covariance:
    """Second derivatives of (form / sigma_a^2 + log det) / 2, summed over frequencies in one pass."""
    y0, y1, y2 = columns
    edge = 1 - fit.theta1[:, None]
    over = 1 / eigenvalues(1 - edge, data.spread)
    w = (y0 + fit.c1[:, None] * y1 + fit.c2[:, None] * y2) * over
    slope = data.spread - 2 * edge
    bend = slope * over
    terms = (y1 * y1 * over, y1 * y2 * over, y2 * y2 * over, w * y1 * bend, w * y2 * bend, w**2 * slope)
    log_det = jnp.broadcast_to(2 * over - bend**2, y0.shape)
    totals = sums_over_frequencies((*terms, w**2 * (slope * bend - 1), log_det))
    m11, m12, m22, x1, x2, form_slope, form_bend, log_det_bend = totals
    # Frequencies that only fill up a block count as a spread of 2.
    filling = columns[0].shape[0] * columns[0].shape[2] - data.size
    unit = 1 / (1 + fit.theta1**2)
    log_det_bend = log_det_bend - filling * (2 * unit - (2 * fit.theta1 * unit) ** 2)
    scale = fit.form / data.size
    theta1 = form_bend / scale + log_det_bend / 2 - (form_slope / scale) ** 2 / (2 * data.size)
    on_edge = jnp.abs(fit.theta1) > 1 - 1 / data.size
    inverse = invert((m11 / scale, m12 / scale, m22 / scale), (-x1 / scale, -x2 / scale), theta1, on_edge)
    return Covariance(*(v * data.size / (data.size - 3) for v in inverse))
