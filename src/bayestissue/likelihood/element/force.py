"""A force that was recorded beside the deceleration: further rows of the same motion.

F / M = (e^a - m / M) d(t) + zero + noise with M the recorded mass, m that of the tip in front of the sensor
and a the log of what the recorded mass is to be multiplied by, the force's gain counted in (that of the
accelerometer is an error of the deceleration's rows alone). Below the tissue there is no tip, and in d's
place stands the tissue's own force over M, which is more where tissue moves along. d is behind the force's
own low-pass, where it went through one. Given motion and errors the rows are independent of the
deceleration's, so that products and determinants of the two add up. Errors of velocity and contact move both.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.likelihood.element.noise import Noise
from bayestissue.likelihood.element.record import DecelerationRecord, ForceRows
from bayestissue.likelihood.element.response import Response
from bayestissue.likelihood.linear_errors import Products


def force_of(
    predicted: Response, record: DecelerationRecord, log_ratio: Float[Array, " impact"] | None
) -> Float[Array, "impact row"] | None:
    """(e^a - m / M) d at the force's samples [m/s^2]; None of a record without a force."""
    if record.force is None or predicted.force is None or log_ratio is None:
        return None
    return record.force.share(log_ratio)[:, None] * predicted.force.d


def force_rows(
    predicted: Response, record: DecelerationRecord, log_ratio: Float[Array, " impact"]
) -> tuple[Float[Array, "impact *cell row"], Float[Array, "impact *cell error row"]]:
    """(e^a - m / M) d at the force's samples, and what a unit of each error of ``error_sd`` adds to it.

    All 0 where no sample counts; for contact in each cell where that may be in several. Arguments as of
    `with_force`.
    """
    force, here = record.force, predicted.force
    assert force is not None  # noqa: S101 - for the type checker
    assert here is not None  # noqa: S101 - for the type checker
    inside, ratio = force.inside(), force.share(log_ratio)[:, None]
    if here.d.ndim > inside.ndim:
        inside, ratio = inside[:, None], ratio[:, None]
    share = jnp.where(inside, ratio, 0.0)
    one = jnp.broadcast_to(jnp.where(inside, 1.0, 0.0), here.d.shape)
    none = jnp.zeros_like(one)
    late = -share * here.jerk
    return share * here.d, jnp.stack([share * here.by_velocity, none, one, late, none, late], axis=-2)


def with_force(
    products: Products,
    predicted: Response,
    record: DecelerationRecord,
    log_ratio: Float[Array, " impact"],
    log_sigma: Float[Array, " impact"],
    log_force_sigma: Float[Array, " impact"],
) -> Products:
    """Products of the deceleration's rows with those of the force's, in units of the deceleration's noise.

    Args:
        products: of the deceleration's rows.
        predicted: the impact, at the force's samples too.
        record: what was recorded.
        log_ratio: a.
        log_sigma: log of the standard deviation of the deceleration's noise [m/s^2].
        log_force_sigma: of the noise of F / M [m/s^2].
    """
    force = record.force
    assert force is not None  # noqa: S101 - for the type checker
    expected, columns = force_rows(predicted, record, log_ratio)
    if not record.contact.reach:
        expected, columns = expected[:, None], columns[:, None]
    residual = jnp.where(force.inside()[:, None], force.y[:, None] - expected, 0.0)
    parts = jnp.concatenate([residual[:, :, None], columns], axis=2)
    weight = log_sigma - log_force_sigma
    if (noise := noise_of_force(force)) is None:
        gram, count = jnp.einsum("icar,icbr->abci", parts, parts), force.inside().sum(1) + 0.0
        log_determinant = jnp.zeros(len(force.y))
    else:
        thinned = jnp.where(noise.inside[:, None, None], parts[..., :: noise_stride(force)], 0.0)
        in_cells = jax.vmap(Noise.gram, in_axes=(None, 0), out_axes=-1)
        gram, count = jax.vmap(in_cells, out_axes=-1)(noise, thinned), noise.inside.sum(1)
        log_determinant = jax.vmap(Noise.log_determinant)(noise)
    return Products(
        products.gram + gram * jnp.exp(2 * weight),
        products.log_determinant + log_determinant - 2 * count * weight,
        products.n_values + count,
    )


def noise_stride(force: ForceRows) -> int:
    """How far apart the samples are that are asked."""
    return 1 if force.colour is None else force.colour.stride


def noise_of_force(force: ForceRows) -> Noise | None:
    """Its noise over sigma, on the samples that are asked; None where that is white."""
    if force.colour is None or force.rate is None:
        return None
    inside = force.inside()[:, :: noise_stride(force)]
    none = jnp.zeros((len(inside), 0, inside.shape[1]))
    return Noise(inside, none, force.colour.first[force.rate], force.colour.predictor[force.rate])
