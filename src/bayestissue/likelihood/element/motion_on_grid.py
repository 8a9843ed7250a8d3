"""A free oscillator on an even grid of times, from few exponentials and sines.

x'' + p x' + q x = 0 with p = 2 zeta omega_n and q = omega_n^2 maps its state from t to t + s by a matrix
that is the product of those of t and of s. A grid of n times is therefore the product of three grids whose
lengths multiply to n: of their few times alone exponentials and sines are taken.
"""

from __future__ import annotations

from math import factorial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.likelihood.transforms import BLOCKS
from bayestissue.oscillator.entire import damped_pair

# (sin(sqrt q) / sqrt q - cos(sqrt q)) / (2 q) in powers of q
_BEND_SERIES = tuple((-1.0) ** k * (k + 1) / factorial(2 * k + 3) for k in range(10))


class Response(NamedTuple):
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


def response(time: Array, omega_n: Array, zeta: Array) -> Response:
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
    return Response(x, cosine - zeta * omega_n * x, time**3 * bend, time + jnp.zeros_like(x))


def response_in_blocks(
    first_time: Float[Array, " impact"],
    dt: Float[Array, " impact"],
    omega_n: Float[Array, " impact"],
    zeta: Float[Array, " impact"],
    lanes: int,
) -> Response:
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
    coarse = Response(*(part[:, :BLOCKS].T[..., None] for part in few))
    middle = Response(*(part[:, BLOCKS:-BLOCKS, None] for part in few))
    fine = Response(*(part[:, None, -BLOCKS:] for part in few))
    within = _once(Response(*(part.reshape(len(dt), lanes) for part in _after(middle, fine, *parameters))))
    p, q = (parameter[..., 0] for parameter in parameters)
    return _after(coarse, within, p, q)


def _once(parts: Response) -> Response:
    """The same, but made before anything that reads it, which would otherwise make it anew at each reading.

    Each part by itself: one that is not read is not made.
    """
    return Response(*(jax.lax.optimization_barrier(part) for part in parts))


def _after(first: Response, second: Response, p: Array, q: Array) -> Response:
    """The response at the sum of two times: products of the states, and of their derivatives by q."""
    from_rest = second.v + p * second.x
    second_bend = second.time * second.x / 2 - p / 2 * second.w
    first_bend = first.time * first.x / 2 - p / 2 * first.w
    return Response(
        first.x * from_rest + first.v * second.x,
        first.v * second.v - q * first.x * second.x,
        first.w * from_rest
        + first.x * (second_bend + p * second.w)
        + first_bend * second.x
        + first.v * second.w,
        first.time + second.time,
    )
