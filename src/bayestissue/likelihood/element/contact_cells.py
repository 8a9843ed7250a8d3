"""Contact where a recording does not show its moment: in one of several cells, and anywhere in it.

A force that rises from 0 has its first samples lost in noise. Contact may then be in any of some cells
before the first sample that is certain to be in contact, each an odd number of sampling intervals long.
Beforehand all moments are as likely, with a density of one per sampling interval: that of a force that jumps,
which must have come between two samples. Within a cell the trace is linear in the moment, about the cell's
middle, and the cells' densities add up.

From cell to cell the same response is shifted by whole samples. It is made once, and so are its products with
itself, but for what enters or leaves at the ends of a trace; only its products with the data are made for
each. Samples before the first count by how much likelier they are than a quiet part of the recorder's noise
would make them, as elements that jump leave them out; of autoregressive noise they do not count. Beside a
discrepancy, which takes up what a wrong moment does to a trace, contact is between two samples instead.

Behind a recorder's low-pass every force rises from 0, and where the filter is fast beside the sampling, an
interval is divided into as many cells as keep a trace linear in each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from bayestissue.likelihood.element.response import CONTACT, ElementRecord, Response, columns
from bayestissue.likelihood.linear_errors import LOG_2PI, Products
from bayestissue.likelihood.quadratic import sums_over_frequencies
from bayestissue.likelihood.transforms import BLOCKS, FILLED

# Among the chain's errors.
_ROOT_12 = 12**0.5


def shape(record: ElementRecord) -> tuple[int, int]:
    """How many cells there are, and how many sampling intervals each has."""
    assert record.before is not None  # noqa: S101 - for the type checker
    return record.before.shape[0], record.before.shape[2]


def cell_width(record: ElementRecord) -> float:
    """Of a cell, in sampling intervals."""
    return shape(record)[1] / (1 if record.low_pass is None else record.low_pass.phase.shape[0])


def middles(record: ElementRecord) -> Float[Array, "cell impact"]:
    """From the middle of each cell to the first sample [s]; the first cell is the last before that sample.

    Behind a low-pass a row of them for each phase, by as much later as the filter looks ahead.
    """
    cells, width = shape(record)
    if record.low_pass is not None:
        interval = jnp.arange(cells) + record.low_pass.phase[:, None] - record.low_pass.lead
        return interval.reshape(-1, 1) * record.dt
    return (jnp.arange(cells)[:, None] + 0.5) * width * record.dt


def error_sd(record: ElementRecord, whole: Float[Array, "impact 4"]) -> Float[Array, "impact 4"]:
    """The errors' standard deviations, that of contact in its cell; ``whole`` has that of all cells."""
    return whole.at[:, CONTACT].set(cell_width(record) * record.dt / _ROOT_12)


def products(
    response: Response,
    value: Float[Array, "impact sample"],
    record: ElementRecord,
    *,
    linear: bool,
) -> Products:
    """As of `bayestissue.likelihood.linear_errors`, each [cell, impact]; noise is white.

    Args:
        response: from contact on.
        value: the traces.
        record: what was recorded.
        linear: whether the response is in proportion to the velocity.
    """
    return _of_phases(
        response, record, lambda phase_response: _of_one_phase(phase_response, value, record, linear=linear)
    )


def _of_phases(
    response: Response, record: ElementRecord, products_of: Callable[[Response], Products]
) -> Products:
    """The products by contact at each phase of a sampling interval, one after another along the cells."""
    if record.low_pass is None:
        return products_of(response)
    finer = record.low_pass.phase.shape[0]
    by_phase = [
        products_of(Response(*(part[:, phase::finer] for part in response))) for phase in range(finer)
    ]
    cells = (shape(record)[0], len(record.dt))
    gram = jax.tree.map(
        lambda *parts: jnp.concatenate([jnp.broadcast_to(part, cells) for part in parts]),
        *(products.gram for products in by_phase),
    )
    return by_phase[0]._replace(gram=gram)


def _of_one_phase(
    response: Response, value: Float[Array, "impact sample"], record: ElementRecord, *, linear: bool
) -> Products:
    slides = _Slides(record)
    window = jnp.where(record.inside(), value, 0.0)
    whole = slides.whole(window)
    parts = [response.d, -response.jerk] if linear else [response.d, -response.jerk, response.by_velocity]
    with_data, among_columns, levels = slides.sums(whole, parts)
    count = record.n_samples + (0.0 if record.n_before is None else record.n_before)
    residual = [product - among_columns[a][0] for a, product in enumerate(with_data)]
    # Of residual, gain, contact, velocity.
    lower = [[(whole**2).sum(-1) - with_data[0] - residual[0]]]
    lower += [[residual[a], *among_columns[a]] for a in range(len(parts))]
    offset = [whole.sum(-1) - levels[0], *levels]
    if linear:
        velocity = record.velocity
        row = [
            *(entry / velocity for entry in (residual[0], among_columns[0][0], among_columns[1][0])),
            among_columns[0][0] / velocity**2,
        ]
        lower.append(row)
        offset.append(levels[0] / velocity)
    order = (0, 3, 1, None, 2)
    entries = tuple(
        tuple(_entry(lower, offset, count, order[a], order[b]) for b in range(len(order)))
        for a in range(len(order))
    )
    return Products(entries, jnp.zeros_like(count), count)


def _entry(
    lower: list[list[Array]], offset: list[Array], count: Array, a: int | None, b: int | None
) -> Array:
    if a is None or b is None:
        return count if a is b else offset[b if a is None else a]  # type: ignore[index]
    return lower[max(a, b)][min(a, b)]


def quiet_density(record: ElementRecord) -> Float[Array, " impact"]:
    """Log density of the samples before the first as a quiet part of the recorder's noise."""
    if record.before is None or record.n_before is None or record.quiet_sd is None:
        return jnp.zeros_like(record.dt)
    squares = (_early(record) ** 2).sum(-1) / record.quiet_sd**2
    return -(record.n_before * (LOG_2PI + 2 * jnp.log(record.quiet_sd)) + squares) / 2


def _early(record: ElementRecord) -> Float[Array, "impact sample"]:
    """The samples before the first in a row, 0 where they do not count."""
    assert record.before is not None  # noqa: S101 - for the type checker
    row = jnp.moveaxis(record.before, 0, 1).reshape(record.d.shape[0], -1)
    if record.n_before is None:
        return jnp.zeros_like(row)
    return jnp.where(jnp.arange(row.shape[1]) >= row.shape[1] - record.n_before[:, None], row, 0.0)


def products_in_columns(
    response: Response,
    value: Float[Array, "impact sample"],
    record: ElementRecord,
    products_of: Callable[[tuple[Array, ...]], Products],
) -> Products:
    """The same where noise is not white, by ``products_of`` residual and columns of each cell."""

    def of_one_phase(response: Response) -> Products:
        inside, samples = record.inside(), record.d.shape[1]
        by_cell = []
        for shift in _Slides(record).shifts:
            here = Response(*(jnp.where(inside, part[:, shift : shift + samples], 0.0) for part in response))
            by_cell.append(products_of((jnp.where(inside, value - here.d, 0.0), *columns(here, record))))
        return by_cell[0]._replace(
            gram=jax.tree.map(lambda *cells: jnp.stack(cells), *(products.gram for products in by_cell))
        )

    return _of_phases(response, record, of_one_phase)


def products_of_all_rows(
    response: Response,
    value: Float[Array, "impact sample"],
    record: ElementRecord,
    products_of: Callable[[Array, list[Array]], Products],
    *,
    linear: bool,
) -> Products:
    """The same of noise that went through a recorder's filter; the samples before the first count too.

    ``products_of`` is given where there is a sample, and the rows whose products it shall return.
    """
    stride = 1 if record.colour is None else record.colour.stride

    def of_one_phase(response: Response) -> Products:
        slides = _Slides(record)
        y = slides.whole(jnp.where(record.inside(), value, 0.0))[:, ::stride]
        inside = slides.recorded()[:, ::stride]
        parts = [response.d, -response.jerk] if linear else [response.d, -response.jerk, response.by_velocity]
        d, late, *quicker = (jnp.where(inside, slides.slid_rows(part, stride), 0.0) for part in parts)
        plain = products_of(inside, [y, d, jnp.where(inside, 1.0, 0.0), late, *quicker])
        # Residual, velocity, gain, offset and contact time out of these.
        velocity = {1: 1 / record.velocity} if linear else {4: 1.0}
        mixed: list[dict[int, Any]] = [{0: 1.0, 1: -1.0}, velocity, {1: 1.0}, {2: 1.0}, {3: 1.0}]
        gram = tuple(
            tuple(
                sum(a * b * plain.gram[i][j] for i, a in first.items() for j, b in second.items())
                for second in mixed
            )
            for first in mixed
        )
        return plain._replace(gram=gram)

    return _of_phases(response, record, of_one_phase)


class _Slides:
    """Sums over a trace's samples of a response that slides along it, each [..., cell, impact]."""

    def __init__(self, record: ElementRecord) -> None:
        cells, width = shape(record)
        self.shifts = [cell * width + width // 2 for cell in range(cells)]
        self._record, self._reach = record, cells * width
        self._number = self._reach + record.d.shape[1]
        self._within = jnp.arange(self._number) < record.n_samples[:, None]
        offset = jnp.arange(self._reach)
        self._after = record.n_samples[:, None] + offset
        shift = jnp.asarray(self.shifts)[:, None, None]
        self._enters = offset < shift
        before = 0 if record.n_before is None else record.n_before[:, None]
        self._leaves = offset < shift - before

    def whole(self, window: Float[Array, "impact sample"]) -> Array:
        """The samples before the first and those of the window as `against` takes them."""
        return jnp.concatenate([_early(self._record), window], axis=-1)

    def recorded(self) -> Bool[Array, "impact row"]:
        """Where `whole` has a sample that was recorded and counts."""
        record = self._record
        before = 0 if record.n_before is None else record.n_before[:, None]
        early = jnp.arange(self._reach) >= self._reach - before
        early = jnp.broadcast_to(early, (len(record.dt), self._reach))
        return jnp.concatenate([early, record.inside()], axis=-1)

    def slid_rows(self, part: Float[Array, "impact sample"], stride: int) -> Float[Array, "cell impact row"]:
        """A response as `whole` has it in every so many samples, by contact in each cell."""
        longer = jnp.pad(part, ((0, 0), (self._reach, 0)))
        return jnp.stack([longer[:, shift : shift + self._number : stride] for shift in self.shifts])

    def sums(
        self, samples: Array, parts: Sequence[Array]
    ) -> tuple[list[Array], list[list[Array]], list[Array]]:
        """Of the samples times each part, of each part times each before it, and of each part.

        The last over the window, the second over what was recorded before it too. All in one pass.
        """
        width = -(-self._number // FILLED) * FILLED
        # What slides along would otherwise be filled up anew in each sum.
        longer = jax.lax.optimization_barrier(_filled_up(samples, width + self._reach))
        shifted = [_in_blocks(longer[:, self._reach - shift :][:, :width]) for shift in self.shifts]
        inside, *rows = (_in_blocks(_filled_up(x, width)) for x in (self._within + 0.0, *parts))
        pairs = [(a, b) for a in range(len(parts)) for b in range(a + 1)]
        within = [inside * row for row in rows]
        terms = [window * row for row in rows for window in shifted]
        terms += [within[a] * rows[b] for a, b in pairs]
        totals = sums_over_frequencies((*terms, *within))
        number = len(shifted)
        against = [jnp.stack(totals[a * number : (a + 1) * number]) for a in range(len(parts))]
        remaining = totals[len(parts) * number :]
        among_columns = {
            (a, b): self._slid(middle, parts[a], parts[b], self._leaves)
            for (a, b), middle in zip(pairs, remaining, strict=False)
        }
        ones = jnp.ones_like(parts[0])
        levels = [
            self._slid(middle, part, ones, self._leaves)
            for part, middle in zip(parts, remaining[len(pairs) :], strict=True)
        ]
        return against, [[among_columns[a, b] for b in range(a + 1)] for a in range(len(parts))], levels

    def _slid(self, middle: Array, a: Array, b: Array, leaves: Array) -> Array:
        """The sum of a times b where the response begins later, from that at once."""
        late = jnp.take_along_axis(a, self._after, axis=1) * jnp.take_along_axis(b, self._after, axis=1)
        early = (a * b)[:, : self._reach]
        return middle + jnp.where(self._enters, late, 0.0).sum(-1) - jnp.where(leaves, early, 0.0).sum(-1)


def _filled_up(rows: Float[Array, "impact sample"], width: int) -> Float[Array, "impact sample"]:
    return jnp.pad(rows, ((0, 0), (0, width - rows.shape[1])))


def _in_blocks(rows: Float[Array, "impact sample"]) -> Float[Array, "block impact lane"]:
    return rows.reshape(len(rows), BLOCKS, -1).swapaxes(0, 1)
