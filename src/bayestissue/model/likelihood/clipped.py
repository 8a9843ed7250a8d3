"""Samples at the sensor's limit, which say of the deceleration that it was there or beyond.

With y the samples that are not clipped and c those that are, p(y, c) = p(y) P(every c beyond its limit |
y). p(y) has the errors of the measuring chain integrated out as without clipped samples. Given y and the
noise's sigma a clipped sample is m_i + b_i' z plus noise, z being standard normals that stand for what y
leaves open of the errors: see `bayestissue.model.likelihood.linear_errors.predicted_given`. So

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

from bayestissue.model.likelihood import small
from bayestissue.model.likelihood.channels import SensorTrace
from bayestissue.model.likelihood.linear_errors import Errors, Products, predicted_given
from bayestissue.model.likelihood.noise import TraceNoise
from bayestissue.model.likelihood.record import DecelerationRecord


def log_probability(
    channel: SensorTrace[TraceNoise], record: DecelerationRecord, products: Products, errors: Errors
) -> Float[Array, "cell impact"]:
    """Log P for contact in each cell.

    Args:
        channel: of the deceleration.
        record: the traces, some samples of which are clipped.
        products: of all samples that are not.
        errors: of the chain, and the discrepancy's.
    """
    assert record.clipped is not None  # noqa: S101 - for the type checker
    reach, log_sigma = record.contact.reach, channel.log_sigma
    further = jnp.transpose(channel.columns[..., reach:], (2, 3, 1, 0))
    mean, along = predicted_given(products, errors, further)
    # The residual is the limit less the impact.
    above = mean - jnp.transpose(channel.residual[..., reach:], (2, 1, 0))
    sign = jnp.where(record.inside(), record.clipped, 0.0).T[:, None]
    at_limit, scaled = sign != 0, sign * jnp.exp(-log_sigma)
    a = jnp.where(at_limit, scaled * above, 0.0)
    log_phi = jnp.where(at_limit, log_ndtr(a), 0.0)
    h = jnp.where(at_limit, jnp.exp(-(a**2 + small.LOG_2PI) / 2 - log_phi), 0.0)
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
