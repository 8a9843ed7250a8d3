"""The deceleration that a recorder makes of impacts, all of one batch in one compiled call."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.elements import linear, solver
from bayestissue.elements.element import Element, complete, deceleration_of
from bayestissue.elements.registry import element as named

LONGEST = 4.0
_STEPS = 256


@partial(jax.jit, static_argnames=("element", "count"))
def decelerations(
    element: str,
    parameters: dict[str, Float[Array, " impact"]],
    mass: Float[Array, " impact"],
    velocity: Float[Array, " impact"],
    first_time: Float[Array, " impact"],
    dt: Float[Array, " impact"],
    count: int,
) -> Float[Array, "impact sample"]:
    """F / M at ``first_time`` + k ``dt`` after contact, k = 0 ... count - 1; 0 once the tissue lets go.

    Args:
        element: name of what is hit.
        parameters: of the element, by name.
        mass: kg.
        velocity: at contact, m/s.
        first_time: s, at most ``dt``.
        dt: s.
        count: number of samples.
    """
    which, p, y = _path(element, parameters, mass, velocity, first_time, dt, count)
    columns = {name: value if value.ndim == 0 else value[:, None] for name, value in p.items()}
    d = deceleration_of(which, columns, mass[:, None], y)
    has_pushed = jnp.cumsum(d > 0, axis=1) > 0
    let_go = jnp.cumsum((d <= 0) & has_pushed, axis=1) > 0
    return jnp.where(let_go, 0.0, jnp.maximum(d, 0.0))


@partial(jax.jit, static_argnames="element")
def peak_over(
    element: str,
    parameters: dict[str, Float[Array, " impact"]],
    mass: Float[Array, " impact"],
    velocity: Float[Array, " impact"],
    unit: Float[Array, " impact"],
) -> Float[Array, " impact"]:
    """Time to zero velocity over ``unit``, s, to 1/64; `LONGEST` where the impactor creeps on beyond it."""
    dt = unit * LONGEST / _STEPS
    _, _, y = _path(element, parameters, mass, velocity, jnp.zeros_like(unit), dt, _STEPS)
    stopped = y[1] <= 0
    step = jnp.where(stopped.any(axis=1), jnp.argmax(stopped, axis=1), _STEPS)
    return step * LONGEST / _STEPS


def _path(
    element: str,
    parameters: dict[str, Array],
    mass: Array,
    velocity: Array,
    first: Array,
    dt: Array,
    count: int,
) -> tuple[Element, dict[str, Array], Array]:
    which = named(element)
    p = complete(which, parameters, None)
    grid = linear.even_grid if which.linear else solver.even_grid
    return which, p, grid(which, p, mass, velocity, first, dt, count)


@jax.jit
def recorded(
    deceleration: Float[Array, "impact sample"],
    gain: Float[Array, " impact"],
    offset: Float[Array, " impact"],
    noise: Float[Array, "impact sample"],
) -> Float[Array, "impact sample"]:
    """The recorder's samples: gain, and offset and noise in units of each impact's peak deceleration."""
    peak = jnp.max(deceleration, axis=1, keepdims=True)
    return gain[:, None] * deceleration + peak * (offset[:, None] + noise)
