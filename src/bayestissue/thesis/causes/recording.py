"""The deceleration that a recorder makes of impacts, all of one batch in one compiled call."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.elements import linear
from bayestissue.elements.element import (
    Element,
    at_contact,
    complete,
    deceleration_of,
    rates_of_motion,
)
from bayestissue.elements.registry import element as named
from bayestissue.elements.solver import cubic

LONGEST = 4.0
_UNHEARD_OF = 1e7
_CONTACT_STEPS = 1024
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

    NaN throughout for an impact whose steps are too long for so stiff an element: their errors then grow
    beyond a million g.

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
    pushes = jnp.where(let_go, 0.0, jnp.maximum(d, 0.0))
    followed = (pushes < _UNHEARD_OF).all(axis=1, keepdims=True)
    return jnp.where(followed, pushes, jnp.nan)


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
    if which.linear:
        return which, p, linear.even_grid(which, p, mass, velocity, first, dt, count)
    return which, p, _stepped(which, p, mass, velocity, first[:, None] + jnp.arange(count) * dt[:, None])


def _stepped(which: Element, p: dict[str, Array], mass: Array, velocity: Array, time: Array) -> Array:
    """The state at ``time`` by equal steps of Runge and Kutta over twice the contact of an undamped spring K.

    A stiffer or damped element lets go sooner; at later times the state stays that at the end. Between steps
    it is the cubic through states and rates.
    """
    step = 2 * jnp.pi * jnp.sqrt(mass / p["K"]) / _CONTACT_STEPS

    def rates(y: Array) -> Array:
        derivative = rates_of_motion(which, p, mass, y)
        return derivative.at[1].set(jnp.minimum(derivative[1], 0.0))

    def advance(y: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        k1 = rates(y)
        k2 = rates(y + step / 2 * k1)
        k3 = rates(y + step / 2 * k2)
        k4 = rates(y + step * k3)
        return y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4), (y, k1)

    _, (y, slope) = jax.lax.scan(advance, at_contact(which, velocity), None, length=_CONTACT_STEPS + 1)
    index = jnp.clip(jnp.floor(time / step[:, None]), 0, _CONTACT_STEPS - 1).astype(int)
    impact = jnp.arange(len(mass))[:, None]
    (y0, y1), (k0, k1) = (
        [jnp.moveaxis(part[index + k, :, impact], -1, 0) for k in (0, 1)] for part in (y, slope)
    )
    into = jnp.clip(time / step[:, None] - index, 0.0, 1.0)
    return cubic((y0, y1), (k0, k1), into, step[:, None])


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
