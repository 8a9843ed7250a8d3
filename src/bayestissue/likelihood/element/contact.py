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

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.likelihood.element.noise import Noise, filtered
from bayestissue.likelihood.element.record import CONTACT, OF_FORCE, DecelerationRecord
from bayestissue.likelihood.element.response import Response, columns
from bayestissue.likelihood.linear_errors import Products

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


class ByCell(NamedTuple):
    """A trace, those samples before the first that may count among it, for contact in each cell.

    Attributes:
        residual: what the impact leaves of it [m/s^2].
        columns: what a unit of each error adds, as `DecelerationRecord.error_sd` has them.
    """

    residual: Float[Array, "impact cell row"]
    columns: Float[Array, "impact cell error row"]


def rows_by_cell(response: Response, record: DecelerationRecord) -> ByCell:
    """The rows of which `products` are, where these are made cell by cell; no recorder's low-pass."""
    reach = record.contact.reach
    if not reach:
        parts = jnp.stack(columns(response, record), axis=1)[:, None]
        return ByCell((record.d - response.d)[:, None], parts)
    samples = jnp.concatenate([record.contact.before, record.d], axis=1)
    of_errors = (response.by_velocity, response.d, jnp.ones_like(response.d), -response.jerk)
    parts = jnp.stack(of_errors, axis=1)
    if record.uneven is not None:
        parts = parts.reshape(*parts.shape[:2], reach, -1).swapaxes(1, 2)
    else:
        width = samples.shape[1]
        longer = jnp.pad(parts, ((0, 0), (0, 0), (reach, 0)))
        parts = jnp.stack([longer[..., cell : cell + width] for cell in range(reach)], axis=1)
    parts = parts.at[:, :, 2].set(offset_row(record)[:, None])
    return ByCell(samples[:, None] - parts[:, :, 1], parts)


def offset_row(record: DecelerationRecord) -> Float[Array, "impact row"]:
    """What a unit of the zero's error adds to each sample, those before the first among them."""
    before = jnp.where(record.contact.shows_offset, 1.0, 0.0)
    return jnp.concatenate([before, jnp.ones_like(record.d)], axis=1)


def products(response: Response, record: DecelerationRecord, noise: Noise) -> Products:
    """Products of the residual and the errors' columns, each [cell, impact]; of a known contact one cell."""
    reach, stride = record.contact.reach, record.colour.stride
    if record.clipped is not None or (reach and record.uneven is not None):
        by_cell = rows_by_cell(response, record)
        parts = jnp.concatenate([by_cell.residual[:, :, None], by_cell.columns], axis=2)
        parts = jnp.where(noise.inside[:, None, None], parts, 0.0)
        gram = jax.vmap(jax.vmap(Noise.gram, in_axes=(None, 0)), out_axes=-1)(noise, parts)
        gram = jnp.moveaxis(gram, 0, 2)
    elif reach:
        samples = jnp.concatenate([record.contact.before, record.d], axis=1)[:, ::stride]
        from_contact = (response.by_velocity, response.d, jnp.ones_like(response.d), -response.jerk)
        in_cells = partial(_gram_in_cells, reach, len(record.phase), stride)
        rows = samples, jnp.where(noise.inside, offset_row(record)[:, ::stride], 0.0)
        gram = jax.vmap(in_cells, out_axes=-1)(noise, *rows, jnp.stack(from_contact, axis=1))
    else:
        residual = jnp.where(record.inside(), record.d - response.d, 0.0)
        parts = jnp.stack([residual, *columns(response, record)], axis=1)[..., ::stride]
        gram = jax.vmap(Noise.gram, out_axes=-1)(noise, parts)[:, :, None]
    if reach and record.force is not None:
        # Errors of the force's zero and clock are nothing to the deceleration.
        of_deceleration = np.delete(np.arange(1 + record.error_sd.shape[1]), 1 + np.array(OF_FORCE))
        whole = jnp.zeros((len(of_deceleration) + 2, len(of_deceleration) + 2, *gram.shape[2:]))
        gram = whole.at[np.ix_(of_deceleration, of_deceleration)].set(gram)
    return Products(gram, jax.vmap(Noise.log_determinant)(noise), noise.inside.sum(-1) + 0.0)


def _gram_in_cells(
    reach: int,
    finer: int,
    stride: int,
    noise: Noise,
    samples: Float[Array, " row"],
    offset: Float[Array, " row"],
    parts: Float[Array, "4 time"],
) -> Float[Array, "5 5 cell"]:
    """Products of residual, velocity, gain, offset and contact of one impact, for contact in each cell.

    Args:
        reach: in how many sampling intervals contact may be.
        finer: cells of an interval.
        stride: every how many samples are asked.
        noise: of the trace.
        samples: the trace, beginning with the samples before the first.
        offset: what a unit of the zero's error adds to each of these.
        parts: what by-velocity, deceleration, 1 and minus the jerk are from contact on, on the finer grid.
    """
    by_phase = jnp.moveaxis(parts.reshape(4, -1, finer), -1, 0)
    if noise.is_white:
        gram = jax.vmap(lambda phase: _slid_gram(reach, noise, samples, offset, phase))(by_phase)
    else:
        gram = jax.vmap(lambda phase: _gram_by_cell(reach, stride, noise, samples, offset, phase))(by_phase)
    return jnp.moveaxis(gram.reshape(-1, 5, 5), 0, -1)


def _gram_by_cell(
    reach: int,
    stride: int,
    noise: Noise,
    samples: Float[Array, " row"],
    offset: Float[Array, " row"],
    parts: Float[Array, "4 time"],
) -> Float[Array, "cell 5 5"]:
    """The products under any noise, cell by cell.

    What a filter's noise makes of the response from its first p samples on is shifted with it, and made once.
    """
    longer = jnp.pad(parts, ((0, 0), (reach, 0)))
    shifted = [longer]
    if noise.is_filtered:
        shifted.append(filtered(longer, noise.predictor, stride))
    whitened = noise.whitened(jnp.stack([samples, offset]))

    def of_cell(shift: Array) -> Array:
        rows, *later = (jax.lax.dynamic_slice(part, (0, shift), parts.shape)[:, ::stride] for part in shifted)
        rows = jnp.where(noise.inside, rows, 0.0)
        white = noise.completed(rows, *later) if later else noise.whitened(rows)
        by_velocity, d, _, late = white
        return noise.gram_of_white(jnp.stack([whitened[0] - d, by_velocity, d, whitened[1], late]))

    return jax.vmap(of_cell)(jnp.arange(reach))


def _slid_gram(
    reach: int,
    noise: Noise,
    samples: Float[Array, " row"],
    offset: Float[Array, " row"],
    parts: Float[Array, "4 time"],
) -> Float[Array, "cell 5 5"]:
    """The products under white noise: by how much those of the first cell change from cell to cell.

    Response k meets sample k + reach - s where contact is s intervals before the last cell.
    """
    recorded, number = noise.inside[:reach].sum(), noise.inside[reach:].sum()
    width = parts.shape[1]
    shift, response = jnp.arange(reach)[:, None], jnp.arange(reach)

    def among(values: Array, counts: Array) -> Array:
        return jnp.einsum("sk,ak,bk->sab", counts + 0.0, values, values)

    longer = jnp.pad(samples, (0, reach))
    slid = [longer[reach - cell :][:width] for cell in range(reach)]
    window = jnp.where(jnp.arange(width) < number, parts, 0.0)
    sums = jnp.concatenate([jnp.stack(slid), window]) @ parts.T
    with_samples, among_parts = sums[:reach], sums[reach:]
    enters, leaves = jax.lax.dynamic_slice(parts, (0, number), (4, reach)), parts[:, :reach]
    among_parts += among(enters, response < shift)
    # The offset counts before contact too, but not where it does not show.
    with_offset = among_parts[:, 2] - among(leaves, response < shift - offset[:reach].sum())[:, 2]
    with_offset = with_offset.at[:, 2].set(offset.sum())
    among_parts -= among(leaves, response < shift - recorded)
    among_parts = among_parts.at[:, 2].set(with_offset).at[:, :, 2].set(with_offset)
    with_samples = with_samples.at[:, 2].set(samples @ offset)
    squares = jnp.broadcast_to(samples @ samples, (reach, 1, 1))
    top = jnp.concatenate([squares, with_samples[:, None]], axis=2)
    gram = jnp.concatenate([top, jnp.concatenate([with_samples[..., None], among_parts], axis=2)], axis=1)
    # The residual is samples less deceleration.
    gram = gram.at[:, 0].add(-gram[:, 2])
    return gram.at[:, :, 0].add(-gram[:, :, 2])
