"""Samples at the sensor's limit, which say of the deceleration that it was there or beyond.

With y the samples that are not clipped and c those that are, p(y, c) = p(y) P(every c beyond its limit |
y). p(y) has the errors of the measuring chain integrated out as without clipped samples. Given y and the
noise's sigma a clipped sample is m_i + b_i' z plus noise, z being standard normals that stand for what y
leaves open of the errors: see `bayestissue.likelihood.linear_errors.predicted_given`. So

    P = int N(z; 0, 1) prod_i Phi(s_i (m_i + b_i' z - L) / sigma) dz,

s_i = 1 at an upper limit L and -1 at a lower one. The integrand is log concave in z and nearly constant, y
having far more samples than there are errors: by Laplace's method from z = 0,

    log P = sum_i log Phi(a_i) + g' H^-1 g / 2 - log det H / 2,   a_i = s_i (m_i - L) / sigma,
    g = sum_i s_i h_i b_i / sigma,   H = 1 + sum_i h_i (h_i + a_i) b_i b_i' / sigma^2,
    h_i = phi(a_i) / Phi(a_i).

That is exact far from the limit on either side. A discrepancy's modes are errors like the others. An error
of the contact time that is uniform is not cut off at its bounds here: near the peak hardly anything depends
on it. Noise that is not white would have samples beside a plateau say what is in it, and so would a
recorder's filter: these are not for clipped samples.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jax.scipy.special import log_ndtr
from jaxtyping import Float

from bayestissue.likelihood import small
from bayestissue.likelihood.element import contact
from bayestissue.likelihood.element.record import DecelerationRecord
from bayestissue.likelihood.element.response import Response
from bayestissue.likelihood.linear_errors import LOG_2PI, Products, predicted_given


def log_probability(
    predicted: Response,
    record: DecelerationRecord,
    error_sd: Float[Array, "#cell impact error"],
    log_sigma: Float[Array, " impact"],
    log_discrepancy: Float[Array, " impact"] | None = None,
) -> Float[Array, "cell impact"]:
    """Log P for contact in each cell.

    Args:
        predicted: the impact.
        record: the traces, some samples of which are clipped.
        error_sd: of the chain's errors.
        log_sigma: log of the noise's standard deviation [m/s^2].
        log_discrepancy: log of the discrepancy's rms [m/s^2]; None without one.
    """
    assert record.clipped is not None  # noqa: S101 - for the type checker
    reach = record.contact.reach
    rows = contact.rows_by_cell(predicted, record)
    columns = rows.columns
    if log_discrepancy is not None:
        basis = jnp.pad(record.discrepancy.basis, ((0, 0), (0, 0), (reach, 0)))[:, None]
        basis = jnp.broadcast_to(basis, (*columns.shape[:2], *basis.shape[2:]))
        columns = jnp.concatenate([basis, columns], axis=2)
        sd = jnp.exp(log_discrepancy)[:, None] * jnp.sqrt(record.discrepancy.share)
        sd = jnp.broadcast_to(sd, (len(error_sd), *sd.shape))
        error_sd = jnp.concatenate([sd, error_sd], axis=-1)
    observed = jnp.concatenate([record.contact.counts, record.observed()], axis=1)
    parts = jnp.concatenate([rows.residual[:, :, None], columns], axis=2)
    observed_parts = jnp.where(observed[:, None, None], parts, 0.0)
    # [part, part, cell, impact] and [error, sample, cell, impact]
    gram = jnp.einsum("icar,icbr->abci", observed_parts, observed_parts)
    count = observed.sum(-1) + 0.0
    products = Products(gram, jnp.zeros_like(count), count)
    further = jnp.transpose(columns[..., reach:], (2, 3, 1, 0))
    mean, along = predicted_given(products, log_sigma, error_sd, further, record.contact.uniform)
    # The residual is the limit less the impact.
    above = mean - jnp.transpose(rows.residual[..., reach:], (2, 1, 0))
    sign = jnp.where(record.inside(), record.clipped, 0.0).T[:, None]
    at_limit, scaled = sign != 0, sign * jnp.exp(-log_sigma)
    a = jnp.where(at_limit, scaled * above, 0.0)
    log_phi = jnp.where(at_limit, log_ndtr(a), 0.0)
    h = jnp.where(at_limit, jnp.exp(-(a**2 + LOG_2PI) / 2 - log_phi), 0.0)
    b = [scaled * part for part in along]
    slope = [(h * part).sum(0) for part in b]
    bend = h * (h + a)
    curvature = [
        [(bend * first * second).sum(0) + (1.0 if i == j else 0.0) for j, second in enumerate(b)]
        for i, first in enumerate(b)
    ]
    factor = small.cholesky(curvature)
    half = small.solve_lower(factor, slope)
    return log_phi.sum(0) + small.dot(half, half) / 2 - small.log_diagonal(factor)
