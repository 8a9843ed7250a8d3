"""Log likelihood of a spring and damper side by side, white noise and known contact, by a kernel of its own.

The general way, `bayestissue.model.likelihood.element.impact`, gives the same to rounding.

Gain and velocity are one error, d itself being V times the deceleration h(t) of an impact at unit velocity:
they add (gain V + dV) h(t), an offset adds b, and an error tau of the contact time adds -tau V h'(t). Where
gravity g acts along the motion, the answer u(t) to a unit impulse has h = -u'', and a constant force M g adds
g (1 - u'): d = V h + g (1 - u') and d' = V h' + g h.

x'' + p x' + q x = 0 with p = 2 zeta omega_n and q = omega_n^2 maps its state from t to t + s by a matrix
that is the product of those of t and of s. A grid of n times is therefore the product of three grids whose
lengths multiply to n: of their few times alone exponentials and sines are taken.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.mechanics.oscillator.entire import damped_pair
from bayestissue.model.likelihood.element.record import DecelerationRecord
from bayestissue.model.likelihood.linear_errors import (
    Errors,
    Products,
    from_lower_entries,
    marginal_log_likelihood,
)
from bayestissue.model.likelihood.quadratic import sums_over_frequencies
from bayestissue.model.likelihood.transforms import BLOCKS, FILLED


class UnitResponse(NamedTuple):
    """An impact at unit velocity.

    Attributes:
        x: displacement, the answer to a unit impulse [s].
        v: velocity, its derivative [1].
    """

    x: Array
    v: Array


def response(time: Array, omega_n: Array, zeta: Array) -> UnitResponse:
    """The closed form at any times; smooth through critical damping. Arguments broadcast.

    Args:
        time: since contact [s], not negative.
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
    """
    cosine, sine = damped_pair(omega_n * time, zeta)
    x = time * sine
    return UnitResponse(x, cosine - zeta * omega_n * x)


def response_in_blocks(
    first_time: Float[Array, " impact"],
    dt: Float[Array, " impact"],
    omega_n: Float[Array, " impact"],
    zeta: Float[Array, " impact"],
    lanes: int,
) -> UnitResponse:
    """The response at first_time + k dt, k = lane + lanes * block, each [block, impact, lane].

    Args:
        first_time: from contact to the first sample [s].
        dt: sampling interval [s].
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        lanes: a multiple of `BLOCKS`.
    """
    groups = lanes // BLOCKS
    steps = jnp.concatenate([lanes * jnp.arange(BLOCKS), BLOCKS * jnp.arange(groups), jnp.arange(BLOCKS)])
    since = jnp.where(jnp.arange(len(steps)) < BLOCKS, first_time[:, None], 0.0)
    few = _once(response(since + steps * dt[:, None], omega_n[:, None], zeta[:, None]))
    parameters = (2 * (zeta * omega_n)[:, None, None], (omega_n**2)[:, None, None])
    coarse = UnitResponse(*(part[:, :BLOCKS].T[..., None] for part in few))
    middle = UnitResponse(*(part[:, BLOCKS:-BLOCKS, None] for part in few))
    fine = UnitResponse(*(part[:, None, -BLOCKS:] for part in few))
    within = _once(
        UnitResponse(*(part.reshape(len(dt), lanes) for part in _after(middle, fine, *parameters)))
    )
    p, q = (parameter[..., 0] for parameter in parameters)
    return _after(coarse, within, p, q)


def _once(parts: UnitResponse) -> UnitResponse:
    """The same, made before anything that reads it, which would otherwise make it anew at each reading."""
    return UnitResponse(*(jax.lax.optimization_barrier(part) for part in parts))


def _after(first: UnitResponse, second: UnitResponse, p: Array, q: Array) -> UnitResponse:
    """The response at the sum of two times: products of the states."""
    return UnitResponse(
        first.x * (second.v + p * second.x) + first.v * second.x,
        first.v * second.v - q * first.x * second.x,
    )


def log_likelihood(
    omega_n: Float[Array, " impact"],
    zeta: Float[Array, " impact"],
    log_sigma: Float[Array, " impact"],
    record: DecelerationRecord,
) -> Float[Array, " impact"]:
    """Log density of the recorded traces, errors integrated out: one pass over the samples.

    Args:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        log_sigma: log of the noise's standard deviation [m/s^2].
        record: the traces.
    """
    parts = _parts(_motion(omega_n, zeta, record), omega_n, zeta, record)
    entries = sums_over_frequencies(tuple(parts[a] * parts[b] for a in range(4) for b in range(a + 1)))
    count = record.n_samples + 0.0
    products = Products.of_unit_noise(from_lower_entries(entries), jnp.zeros_like(count), count, log_sigma)
    return marginal_log_likelihood(products, Errors(record.error_sd, record.contact.uniform))


def _motion(omega_n: Array, zeta: Array, record: DecelerationRecord) -> UnitResponse:
    if record.uneven is not None:
        # Nothing is shared between times that are on no grid.
        return response(_in_blocks(record.time(), record), omega_n[:, None], zeta[:, None])
    return response_in_blocks(record.first_time, record.dt, omega_n, zeta, _lanes(record))


def _in_blocks(rows: Float[Array, "impact sample"], record: DecelerationRecord) -> Array:
    """[block, impact, lane], 0 past the rows' end."""
    longer = jnp.pad(rows, ((0, 0), (0, BLOCKS * _lanes(record) - rows.shape[1])))
    return longer.reshape(len(rows), BLOCKS, -1).swapaxes(0, 1)


def _parts(
    motion: UnitResponse, omega_n: Array, zeta: Array, record: DecelerationRecord
) -> tuple[Array, Array, Array, Array]:
    """Residual, unit deceleration, ones and the column of the contact time, all 0 past a trace's end."""
    p, q, velocity = (2 * zeta * omega_n)[:, None], (omega_n**2)[:, None], record.velocity[:, None]
    gravity = record.gravity[:, None]
    blocks = _in_blocks(record.d, record)
    block, _, lane = (jax.lax.broadcasted_iota(int, blocks.shape, axis) for axis in range(3))
    inside = jnp.where(lane + block * _lanes(record) < record.n_samples[:, None], 1.0, 0.0)
    unit = inside * (p * motion.v + q * motion.x)
    contact = -velocity * (inside * q * motion.v - p * unit) - gravity * unit
    fall = gravity * inside * (1 - motion.v)
    return blocks - velocity * unit - fall, unit, inside, contact


def _lanes(record: DecelerationRecord) -> int:
    """Samples of a block."""
    return FILLED // BLOCKS * -(-record.d.shape[1] // FILLED)
