"""Contact where a recording does not show its moment: in one of several cells, and anywhere in it.

A force that rises from 0 has its first samples lost in noise. Contact may then be in any sampling interval
before the first sample that is certain to be in contact. Beforehand all moments are as likely, with a density
of one per sampling interval: that of a force that jumps, which must have come between two samples. Within a
cell the trace is linear in the moment, about the cell's middle, and the cells' densities add up.

From cell to cell the same response is shifted by whole samples. It is made once, and where noise is white so
are its products with itself: a sum over a trace's samples then changes by the few that enter at its end, and
those that leave at its beginning.

Where noise is white, samples before the first count by how much likelier they are than a quiet part of the
recorder's noise would make them, as elements that jump leave them out; beside a discrepancy they do not
count. Noise that went through a recorder's filter has them as it has the others.

Behind a recorder's low-pass every force rises from 0, and where the filter is fast beside the sampling, an
interval is divided into as many cells as keep a trace linear in each.

Where contact is known to be at a sample, a cell is the one moment there.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerImpact
from bayestissue.model.likelihood.channels import SensorTrace
from bayestissue.model.likelihood.linear_errors import Products
from bayestissue.model.likelihood.noise import TraceNoise, filtered, products, products_under
from bayestissue.model.likelihood.record import CONTACT, GAIN, OFFSET, DecelerationRecord, ForceRows
from bayestissue.model.likelihood.response import Response, columns

_ROOT_12 = 12**0.5


def cell_width(record: DecelerationRecord) -> Float[Array, "#cell #impact"]:
    """Of each cell, in sampling intervals."""
    if record.uneven is not None:
        return record.uneven.cells[1].T / record.dt
    return jnp.full((1, 1), 1 / len(record.phase))


def error_sd(record: DecelerationRecord) -> Float[Array, "#cell impact error"]:
    """The errors' standard deviations, that of contact within each cell."""
    if not record.contact.reach:
        return record.error_sd[None]
    in_cell = jnp.where(record.contact.uniform, cell_width(record) * record.dt / _ROOT_12, 0.0)
    by_cell = jnp.broadcast_to(record.error_sd, (len(in_cell), *record.error_sd.shape))
    return by_cell.at[..., CONTACT].set(in_cell)


def noise_of(record: DecelerationRecord) -> TraceNoise:
    """The noise of every trace, the samples before the first among it."""
    inside = jnp.concatenate([record.contact.counts, record.observed()], axis=1)
    return TraceNoise.of(inside, record.colour, record.rate)


def channel_of(
    response: Response, record: DecelerationRecord, log_sigma: JaxPerImpact
) -> SensorTrace[TraceNoise]:
    """The deceleration, and samples before the first that may count, for contact in each cell.

    Where contact is not known, no recorder's low-pass is between. Its errors are the weights of the
    discrepancy's modes, and those of the chain as `DecelerationRecord.error_sd` has them.
    """
    reach, parts = record.contact.reach, jnp.stack(columns(response, record), axis=1)
    if not reach:
        samples, d, parts = record.d, response.d[:, None], parts[:, None]
    else:
        samples = jnp.concatenate([record.contact.before, record.d], axis=1)
        if record.uneven is not None:
            parts = parts.reshape(*parts.shape[:2], reach, -1).swapaxes(1, 2)
        else:
            width = samples.shape[1]
            longer = jnp.pad(parts, ((0, 0), (0, 0), (reach, 0)))
            parts = jnp.stack([longer[..., cell : cell + width] for cell in range(reach)], axis=1)
        d, parts = parts[:, :, GAIN], parts.at[:, :, OFFSET].set(offset_row(record)[:, None])
    modes = jnp.broadcast_to(modes_of(record)[:, None], (*parts.shape[:2], *modes_of(record).shape[1:]))
    slopes = jnp.concatenate([modes, parts], axis=2)
    return SensorTrace(samples[:, None] - d, slopes, log_sigma, noise_of(record), record.colour.stride)


def force_channel(
    answer: Response, force: ForceRows, log_ratio: JaxPerImpact, log_sigma: JaxPerImpact
) -> SensorTrace[TraceNoise]:
    """A force that was recorded beside the deceleration, over mass, for contact in each cell.

    F / M = (e^a - m / M) d(t) + zero + noise with M the recorded mass, m that of the tip in front of the
    sensor and a the log of what the recorded mass is to be multiplied by, the force's gain counted in (that
    of the accelerometer is an error of the deceleration alone). Below the tissue there is no tip, and in d's
    place stands the tissue's own force over M, which is more where tissue moves along. d is behind the
    force's own low-pass, where it went through one. Errors of velocity and contact move both channels.

    Args:
        answer: the impact at the force's samples.
        force: what was recorded.
        log_ratio: a.
        log_sigma: log of the standard deviation of the noise of F / M [m/s^2].
    """
    d, by_velocity, jerk = (part if part.ndim == 3 else part[:, None] for part in answer[:3])
    inside = force.inside()
    share = jnp.where(inside, force.share(log_ratio)[:, None], 0.0)[:, None]
    one = jnp.broadcast_to(jnp.where(inside, 1.0, 0.0)[:, None], d.shape)
    none, late = jnp.zeros_like(one), -share * jerk
    residual = jnp.where(inside[:, None], force.y[:, None] - share * d, 0.0)
    columns = jnp.stack([share * by_velocity, none, one, late, none, late], axis=2)
    noise = TraceNoise.of(inside, force.colour, force.rate)
    return SensorTrace(residual, columns, log_sigma, noise, force.colour.stride)


def modes_of(record: DecelerationRecord) -> Float[Array, "impact mode row"]:
    """What a unit of each weight of the discrepancy's modes adds to each sample; nothing before the first."""
    return jnp.pad(record.discrepancy.basis, ((0, 0), (0, 0), (record.contact.reach, 0)))


def offset_row(record: DecelerationRecord) -> Float[Array, "impact row"]:
    """What a unit of the zero's error adds to each sample, those before the first among them."""
    contact = record.contact
    shows = jnp.arange(contact.reach) >= contact.reach - (contact.n_before - contact.n_quiet)[:, None]
    return jnp.concatenate([jnp.where(shows, 1.0, 0.0), jnp.ones_like(record.d)], axis=1)


def products_in_cells(response: Response, record: DecelerationRecord, log_sigma: JaxPerImpact) -> Products:
    """The products of `channel_of`; where the same response is shifted from cell to cell it is made once."""
    reach, stride = record.contact.reach, record.colour.stride
    if not reach or record.uneven is not None or record.clipped is not None:
        return products(channel_of(response, record, log_sigma))
    noise, modes = noise_of(record), modes_of(record)
    samples = jnp.concatenate([record.contact.before, record.d], axis=1)
    fixed = jnp.concatenate([samples[:, None], modes, offset_row(record)[:, None]], axis=1)[..., ::stride]
    fixed = jnp.where(noise.inside[:, None], fixed, 0.0)
    shifted = jnp.stack([response.by_velocity, response.d, -response.jerk], axis=1)
    by_phase = jnp.moveaxis(shifted.reshape(*shifted.shape[:2], -1, len(record.phase)), -1, 0)

    def of_impact(noise: TraceNoise, fixed: Array, shifted: Array) -> Array:
        if noise.is_white:
            return _slid_gram(noise, fixed, shifted, reach)
        return _gram_by_cell(noise, fixed, shifted, reach, stride)

    gram = jax.vmap(lambda shifted: jax.vmap(of_impact)(noise, fixed, shifted))(by_phase)
    # From phase, impact and cell.
    gram = jnp.moveaxis(gram, (0, 1, 2), (2, 4, 3))
    gram = gram.reshape(*gram.shape[:2], -1, gram.shape[-1])
    number = 1 + modes.shape[1]
    offset, by_velocity, d, late = range(number, number + 4)
    # Errors of a force's zero and clock are nothing to the deceleration.
    of_force = [None] * 2 if record.force is not None else []
    order = [*range(number), by_velocity, d, *of_force, offset, late]
    none = jnp.zeros_like(gram[0, 0])
    rows = [[none if a is None or b is None else gram[a, b] for b in order] for a in order]
    # The residual is samples less deceleration.
    rows[0] = [of_samples - of_d for of_samples, of_d in zip(rows[0], rows[order.index(d)], strict=True)]
    for row in rows:
        row[0] = row[0] - row[order.index(d)]
    return products_under(noise, rows, log_sigma)


def _gram_by_cell(
    noise: TraceNoise,
    fixed: Float[Array, "fixed row"],
    shifted: Float[Array, "shifted time"],
    reach: int,
    stride: int,
) -> Float[Array, "cell part part"]:
    """The products of an impact under any noise, cell by cell.

    What a filter's noise makes of the response from its first p samples on is shifted with it, and made once.
    """
    longer = jnp.pad(shifted, ((0, 0), (reach, 0)))
    later, settled = filtered(longer, noise.predictor, stride), noise.whitened(fixed)

    def of_cell(shift: Array) -> Array:
        rows = (
            jax.lax.dynamic_slice(part, (0, shift), shifted.shape)[:, ::stride] for part in (longer, later)
        )
        white = noise.completed(*(jnp.where(noise.inside, part, 0.0) for part in rows))
        white = jnp.concatenate([settled, white])
        return white @ white.T

    return jax.vmap(of_cell)(jnp.arange(reach))


def _slid_gram(
    noise: TraceNoise, fixed: Float[Array, "fixed row"], shifted: Float[Array, "shifted time"], reach: int
) -> Float[Array, "cell part part"]:
    """The products of an impact under white noise: by how much they change from cell to cell.

    Args:
        noise: of the trace.
        fixed: rows that are where the samples are, which begin before the first; the last is the offset's.
        shifted: rows from contact on. Row k meets sample k + reach - s where contact is s intervals before
            the last cell.
        reach: number of cells.
    """
    recorded, number = noise.inside[:reach].sum(), noise.inside[reach:].sum()
    width, moving = shifted.shape[1], jnp.concatenate([shifted, jnp.ones((1, shifted.shape[1]))])
    shift, row = jnp.arange(reach)[:, None], jnp.arange(reach)

    def among(values: Array, counts: Array) -> Array:
        return jnp.einsum("sk,ak,bk->sab", counts + 0.0, values, values)

    longer = jnp.pad(fixed[:-1], ((0, 0), (0, reach)))
    slid = [longer[:, reach - cell :][:, :width] for cell in range(reach)]
    first = jnp.where(jnp.arange(width) < number, moving, 0.0)
    *across, within = jnp.split(
        jnp.concatenate([*slid, first]) @ moving.T, (1 + np.arange(reach)) * len(longer)
    )
    enters, leaves = jax.lax.dynamic_slice(moving, (0, number), (4, reach)), moving[:, :reach]
    within = within + among(enters, row < shift)
    # The offset does not show in all samples before the first.
    with_offset = (within - among(leaves, row < shift - fixed[-1, :reach].sum()))[:, -1:]
    within = within - among(leaves, row < shift - recorded)
    slid_gram = jnp.concatenate([jnp.stack(across), with_offset], axis=1)[..., :-1]
    still = jnp.broadcast_to(fixed @ fixed.T, (reach, len(fixed), len(fixed)))
    upper = jnp.concatenate([still, slid_gram], axis=2)
    return jnp.concatenate(
        [upper, jnp.concatenate([slid_gram.swapaxes(1, 2), within[:, :-1, :-1]], axis=2)], axis=1
    )
