"""What an impact comes to: stiffness, damping and loss that mean the same for every element, and peaks."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from bayestissue.elements.element import (
    GRAVITY,
    Element,
    Outcomes,
    Parameters,
    at_contact,
    deceleration_of,
    falling,
)
from bayestissue.elements.impact import Path, prepared

# What a lab asks of an impact; the first of them are those that its measured motion tells.
MEASURED = ("peak_force", "peak_deceleration", "peak_depth", "time_to_peak")
OUTCOMES = (*MEASURED, "contact_duration", "rebound_velocity", "restitution", "energy_absorbed")
# What may never happen, on a tissue that is never left.
NEVER = ("time_to_peak", "contact_duration")
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(16)
# Between the nodes beside the greatest force, which are 1 % of a contact apart.
_BETWEEN = np.linspace(0.0, 1.0, 33)


def outcomes(
    element: str | Element,
    parameters: Parameters,
    mass: ArrayLike,
    velocity: ArrayLike,
    *,
    diameter: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
) -> Outcomes:
    """What impacts come to; arguments as of `bayestissue.elements.impact`.

    Raises:
        KeyError: there is no such element, or the parameters are not its own.
    """
    which, arguments = prepared(element, parameters, mass, velocity, diameter, gravity)
    return outcomes_of(which, *arguments)


@partial(jax.jit, static_argnames="element")
def outcomes_of(
    element: Element, p: dict[str, Array], mass: Float[Array, " impact"], velocity: Float[Array, " impact"]
) -> Outcomes:
    """`outcomes` of complete parameters, compiled: see `bayestissue.elements.element.complete`."""
    if element.level_outcomes and GRAVITY not in p:
        return element.level_outcomes(p, mass, velocity)
    return _solved(element, p, mass, velocity)


def _solved(element: Element, p: dict[str, Array], mass: Array, velocity: Array) -> Outcomes:
    """Of the path, solved once."""
    path, M, V = Path.solved(element, p, mass, velocity), mass, velocity
    columns = path.columns()

    def decelerates(y: Array) -> Array:
        return deceleration_of(element, columns, M[:, None], y)

    times = path.nodes.time.T
    at_nodes = jnp.where(
        times <= path.leaves[:, None], decelerates(jnp.moveaxis(path.nodes.y, 0, -1)), -jnp.inf
    )
    best = jnp.argmax(at_nodes, axis=1)[:, None]
    low, high = (
        jnp.take_along_axis(times, jnp.clip(best + step, 0, times.shape[1] - 1), axis=1) for step in (-1, 1)
    )
    peak, leaves = (jnp.minimum(when, path.duration) for when in (path.time_to_peak, path.leaves))
    squares_at = (jnp.asarray(_POINTS) + 1) / 2 * peak[:, None]
    greatest_at = jnp.minimum(low + jnp.asarray(_BETWEEN) * (high - low), leaves[:, None])
    # In one go, since what follows the path is long to compile.
    states = path.at(jnp.concatenate([peak[:, None], leaves[:, None], squares_at, greatest_at], axis=1))
    x, v, *inner_states = states[..., 0]
    s, end, last, fall = tuple(inner_states), states[0, :, 1], states[1, :, 1], falling(p)
    among = 2 + len(_POINTS)
    squares = (states[1, :, 2:among] ** 2 @ jnp.asarray(_WEIGHTS)) * peak / 2
    spent = M * (V**2 - v**2) / 2 + M * fall * x - element.stored(x, v, s, p)
    return Outcomes(
        mass=M,
        velocity=V,
        K_tangent=_tangent(element, p, V),
        K_secant=element.force(x, jnp.zeros_like(v), s, p) / x,
        C_equivalent=spent / squares,
        energy_lost=1 - (last / V) ** 2,
        energy_share=1 - (last**2 - 2 * fall * end) / V**2,
        peak_depth=x,
        time_to_peak=path.time_to_peak,
        peak_force=M * _greatest(decelerates(states[..., among:])),
        contact_duration=path.leaves,
        rebound_velocity=-last,
    )


def _greatest(values: Float[Array, "impact place"]) -> Float[Array, " impact"]:
    """The greatest of values at even places: of the parabola through the greatest and its neighbours."""
    best = jnp.clip(jnp.argmax(values, axis=1), 1, values.shape[1] - 2)[:, None]
    before, here, after = (jnp.take_along_axis(values, best + step, axis=1)[:, 0] for step in (-1, 0, 1))
    bend, half = 2 * here - before - after, (after - before) / 2
    inside = jnp.abs(half) < bend
    return jnp.maximum(
        values.max(axis=1), here + jnp.where(inside, half**2 / (2 * jnp.where(inside, bend, 1.0)), 0.0)
    )


def _tangent(element: Element, p: dict[str, Array], velocity: Array) -> Array:
    """The force's slope in x with the internal lengths held, at contact.

    What remembers is slow: at contact its dampers have not yet yielded.
    """
    y = at_contact(element, velocity)
    s = tuple(y[2:])
    return jax.jvp(lambda x: element.force(x, velocity, s, p), (y[0],), (jnp.ones_like(y[0]),))[1]
