"""Linear elements exactly: the state at any time is a matrix exponential times that at contact.

Gravity along the motion is a constant beside the state: a last entry that stays 1.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerImpact
from bayestissue.mechanics.elements.element import GRAVITY, Collision

# (1/2)^14 / 14! is below rounding, and 2^40 times rounding is all that could be asked for.
_ORDER = 14
_HALVINGS = 40
# States that are made before the rest.
_FEW = 16


def transition(
    collision: Collision, time: Float[Array, " impact *time"]
) -> Float[Array, "impact *time state state"]:
    """exp(A t) of y' = A y, smooth through repeated roots; along gravity of (y, 1).

    Times are in units of t itself, so that all entries of the exponent are of one kind: (omega_n t)^2,
    2 zeta omega_n t and time over relaxation time.
    """
    p, mass, size = collision.parameters, collision.mass, 2 + collision.element.states
    unit = jnp.eye(size).reshape(size, size, *[1] * mass.ndim)
    weightless = replace(collision, parameters={name: p[name] for name in p if name != GRAVITY})
    columns = [weightless.rates(jnp.broadcast_to(one, (size, *mass.shape))) for one in unit]
    matrix = jnp.moveaxis(jnp.stack(columns, axis=1), (0, 1), (-2, -1))
    if GRAVITY in p:
        size += 1
        falls = collision.impactor_share * p[GRAVITY]
        matrix = jnp.pad(matrix, [(0, 0)] * mass.ndim + [(0, 1), (0, 1)]).at[..., 1, -1].set(falls)
    time = time.reshape(*time.shape, 1, 1)
    matrix = matrix.reshape(*mass.shape, *[1] * (time.ndim - matrix.ndim), size, size)
    is_velocity = jnp.arange(size) == 1
    row, column = is_velocity[:, None], is_velocity[None, :]
    # 1 and not t where t is 0: there the exponent is 0 in any unit.
    inside = jnp.where(time == 0, 1.0, time)
    scaled = jnp.where(row == column, matrix * time, jnp.where(row, matrix * inside * time, matrix))
    scaled = jnp.where(~row & column & (time == 0), 0.0, scaled)
    result = _exponential(scaled)
    return jnp.where(row == column, result, jnp.where(row, result / inside, result * time))


def _exponential(matrix: Float[Array, "*batch state state"]) -> Float[Array, "*batch state state"]:
    """Exp of matrices: Taylor's polynomial of matrices halved until it is exact, then squared as often.

    Each as often as it needs: one that is beyond all bounds, or not finite, is no concern of the others.
    `jax.scipy.linalg.expm` compiles each of its many orders and tells the same to all digits, but with its
    derivatives took most of a minute to compile.
    """
    size = jnp.abs(jax.lax.stop_gradient(matrix)).sum(-1).max(-1)[..., None, None]
    size = jnp.where(jnp.isfinite(size), jnp.maximum(size, 1e-30), 1.0)
    halvings = jnp.clip(jnp.ceil(jnp.log2(size)) + 1, 0, _HALVINGS)
    small = matrix * jnp.ldexp(jnp.ones(()), -halvings.astype(int))
    unit = jnp.eye(matrix.shape[-1])
    # Horner's scheme: 1 + A (1 + A / 2 (1 + A / 3 (...))), as a loop that is compiled once.
    polynomial = jax.lax.fori_loop(
        0, _ORDER, lambda k, total: unit + small @ total / (_ORDER - k), jnp.broadcast_to(unit, matrix.shape)
    )
    return jax.lax.fori_loop(
        0, halvings.max().astype(int), lambda k, root: jnp.where(k < halvings, root @ root, root), polynomial
    )


def even_grid(
    collision: Collision, first_time: JaxPerImpact, dt: JaxPerImpact, count: int
) -> Float[Array, "state impact sample"]:
    """The state at first_time + k dt, k = 0 ... count - 1, also as the motion goes on before contact.

    The first few states, and the motion's matrices over every so many steps: their products are all states,
    in one loop over vectors.
    """
    steps = jnp.stack([first_time, jnp.broadcast_to(dt, first_time.shape)], axis=-1)
    transitions = transition(collision, steps)
    step, states = transitions[:, 1], range(transitions.shape[-1])
    few = jnp.einsum("iab,bi->ia", transitions[:, 0], _start(collision))[..., None]
    # Each round doubles what is known.
    while few.shape[-1] < min(count, _FEW):
        few = jnp.concatenate([few, step @ few], axis=-1)
        step = step @ step
    blocks = -(-count // few.shape[-1])
    over = jnp.broadcast_to(jnp.eye(len(states)), step.shape)[:, None]
    while over.shape[1] < blocks:
        over = jnp.concatenate([over, step[:, None] @ over], axis=1)
        step = step @ step
    over, few = over[:, :blocks, ..., None], few[:, None]
    # Written out, since so small a product of matrices is a call each.
    size = 2 + collision.element.states
    y = jnp.stack([sum(over[:, :, a, b] * few[:, :, b] for b in states) for a in range(size)])
    return y.reshape(size, len(dt), -1)[..., :count]


def at_times(collision: Collision, time: Float[Array, "impact time"]) -> Float[Array, "state impact time"]:
    """The state at any times, not negative."""
    states = jnp.einsum("itab,bi->ait", transition(collision, time), _start(collision))
    return states[: 2 + collision.element.states]


def _start(collision: Collision) -> Array:
    y = collision.at_contact()
    return jnp.concatenate([y, jnp.ones_like(y[:1])]) if GRAVITY in collision.parameters else y
