"""Log likelihood of a spring and damper side by side, white noise and known contact, by a kernel of its own.

The general way, `bayestissue.likelihood.element.impact`, gives the same and takes three times as long for
its gradient.

Gain and velocity are one error, d itself being V times the deceleration h(t) of an impact at unit velocity:
they add (gain V + dV) h(t), an offset adds b, and an error tau of the contact time adds -tau V h'(t). Where
gravity g acts along the motion, the answer u(t) to a unit impulse has h = -u'', and a constant force M g adds
g (1 - u'): d = V h + g (1 - u') and d' = V h' + g h.

x'' + p x' + q x = 0 with p = 2 zeta omega_n and q = omega_n^2 maps its state from t to t + s by a matrix
that is the product of those of t and of s. A grid of n times is therefore the product of three grids whose
lengths multiply to n: of their few times alone exponentials and sines are taken.
"""

from __future__ import annotations

from math import factorial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.likelihood.element.record import DecelerationRecord
from bayestissue.likelihood.linear_errors import Products, from_lower_entries, marginal_log_likelihood
from bayestissue.likelihood.quadratic import sums_over_frequencies
from bayestissue.likelihood.transforms import BLOCKS, FILLED
from bayestissue.oscillator.entire import damped_pair

# (sin(sqrt q) / sqrt q - cos(sqrt q)) / (2 q) in powers of q
_BEND_SERIES = tuple((-1.0) ** k * (k + 1) / factorial(2 * k + 3) for k in range(10))


class UnitResponse(NamedTuple):
    """An impact at unit velocity, and what its derivatives by p and q are made of.

    Attributes:
        x: displacement, the answer to a unit impulse [s].
        v: velocity, its derivative [1].
        w: the answer to x, that is x convolved with itself: -dx/dq [s^3].
        time: from contact on [s].
    """

    x: Array
    v: Array
    w: Array
    time: Array


def response(time: Array, omega_n: Array, zeta: Array) -> UnitResponse:
    """The closed form at any times; smooth through critical damping. Arguments broadcast.

    w = (x - t c) / (2 omega_d^2) with c = e^(-zeta omega_n t) cos(omega_d t).

    Args:
        time: since contact [s], not negative.
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
    """
    angle = omega_n * time
    cosine, sine = damped_pair(angle, zeta)
    square = angle**2 * (1 - zeta) * (1 + zeta)
    near = jnp.abs(square) < 1
    little = jnp.where(near, square, 0.0)
    series = jnp.full_like(little, _BEND_SERIES[-1])
    for coefficient in _BEND_SERIES[-2::-1]:
        series = series * little + coefficient
    decay = jnp.exp(-jnp.where(near, zeta * angle, 0.0))
    bend = jnp.where(near, decay * series, (sine - cosine) / (2 * jnp.where(near, 1.0, square)))
    x = time * sine
    return UnitResponse(x, cosine - zeta * omega_n * x, time**3 * bend, time + jnp.zeros_like(x))


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
    """The same, but made before anything that reads it, which would otherwise make it anew at each reading.

    Each part by itself: one that is not read is not made.
    """
    return UnitResponse(*(jax.lax.optimization_barrier(part) for part in parts))


def _after(first: UnitResponse, second: UnitResponse, p: Array, q: Array) -> UnitResponse:
    """The response at the sum of two times: products of the states, and of their derivatives by q."""
    from_rest = second.v + p * second.x
    second_bend = second.time * second.x / 2 - p / 2 * second.w
    first_bend = first.time * first.x / 2 - p / 2 * first.w
    return UnitResponse(
        first.x * from_rest + first.v * second.x,
        first.v * second.v - q * first.x * second.x,
        first.w * from_rest
        + first.x * (second_bend + p * second.w)
        + first_bend * second.x
        + first.v * second.w,
        first.time + second.time,
    )


@jax.custom_jvp
def log_likelihood(
    omega_n: Float[Array, " impact"],
    zeta: Float[Array, " impact"],
    log_sigma: Float[Array, " impact"],
    record: DecelerationRecord,
) -> Float[Array, " impact"]:
    """Log density of the recorded traces, errors integrated out: one pass over the samples, two with slopes.

    Args:
        omega_n: natural frequency [rad/s].
        zeta: damping ratio.
        log_sigma: log of the noise's standard deviation [m/s^2].
        record: the traces.
    """
    return _of_entries(
        log_sigma, _entries(*_parts(_motion(omega_n, zeta, record), omega_n, zeta, record)), record
    )


def _of_entries(log_sigma: Array, entries: tuple[Array, ...], record: DecelerationRecord) -> Array:
    count = record.n_samples + 0.0
    products = Products(from_lower_entries(entries), jnp.zeros_like(count), count)
    return marginal_log_likelihood(products, log_sigma, record.error_sd, record.contact.uniform)


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


def _entries(residual: Array, unit: Array, inside: Array, contact: Array) -> tuple[Array, ...]:
    parts = (residual, unit, inside, contact)
    return sums_over_frequencies(tuple(parts[a] * parts[b] for a in range(4) for b in range(a + 1)))


@log_likelihood.defjvp
def _recorded_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """The slopes by p = 2 zeta omega_n and q = omega_n^2 are those by the samples times the samples' own.

    With x the answer to a unit impulse and w that to x, dx/dq = -w and dx/dp is its first derivative in time.
    The deceleration, minus the second derivative of x, therefore has for slopes the second and the third
    derivative of w, and the jerk the third and the fourth; w2, w3 and w4 each follow from those before by
    w2 + p w1 + q w = x. Gravity's part, g (1 - x'), has those of g w1 and g w2.
    """
    omega_n, zeta, log_sigma, record = primals
    motion = _motion(omega_n, zeta, record)
    residual, unit, inside, contact = parts = _parts(motion, omega_n, zeta, record)
    value, pull_back = jax.vjp(lambda s, e: _of_entries(s, e, record), log_sigma, _entries(*parts))
    by_log_sigma, by_entries = pull_back(jnp.ones_like(value))
    # Made before the second pass, not anew for each of its samples.
    by_entries = jax.lax.optimization_barrier(by_entries)
    (rr, ur, uu, ir, iu, _, cr, cu, ci, cc) = (slope[:, None] for slope in by_entries)
    p, q, velocity = (2 * zeta * omega_n)[:, None], (omega_n**2)[:, None], record.velocity[:, None]
    gravity = record.gravity[:, None]
    by_residual = 2 * rr * residual + ur * unit + ir * inside + cr * contact
    by_contact = cr * residual + cu * unit + ci * inside + 2 * cc * contact
    by_unit = ur * residual + 2 * uu * unit + iu * inside + cu * contact - velocity * by_residual
    by_unit, by_jerk, by_fall = by_unit - gravity * by_contact, -velocity * by_contact, -gravity * by_residual
    w1 = motion.time * motion.x / 2 - p / 2 * motion.w
    w2 = motion.x - p * w1 - q * motion.w
    w3 = motion.v - p * w2 - q * w1
    w4 = -(p * motion.v + q * motion.x) - p * w3 - q * w2
    # Two loops: one of both sums has more in hand than a processor has registers.
    (by_q,) = sums_over_frequencies((inside * (by_unit * w2 + by_jerk * w3 + by_fall * w1),))
    (by_p,) = sums_over_frequencies((inside * (by_unit * w3 + by_jerk * w4 + by_fall * w2),))
    slopes = (2 * omega_n * by_q + 2 * zeta * by_p, 2 * omega_n * by_p, by_log_sigma)
    return value, sum(slope * tangent for slope, tangent in zip(slopes, tangents[:3], strict=True))


def _lanes(record: DecelerationRecord) -> int:
    """Samples of a block."""
    return FILLED // BLOCKS * -(-record.d.shape[1] // FILLED)
