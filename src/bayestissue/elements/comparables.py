"""Stiffness, damping and loss that mean the same for every element, and the peaks of an impact."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from bayestissue.elements.element import Element, Parameters, at_contact, deceleration_of, falling
from bayestissue.elements.impact import Path, prepared

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(16)


class Comparables(NamedTuple):
    """What can be compared across elements, each [impact].

    Attributes:
        K_tangent: slope of the force that comes with penetration at contact, a damper's own force left out
            [N/m].
        K_secant: force over penetration where penetration is greatest and the velocity 0 [N/m].
        C_equivalent: of the damper beside the spring that would have lost the same energy from contact to
            peak: (M V^2 / 2 + M g x - energy stored at the peak) / integral of x'^2 [N s/m].
        energy_lost: 1 - (v_end / V)^2, v_end being the velocity at which the impactor leaves: the share of
            its kinetic energy at contact that it has not got back.
        energy_share: work done on the tissue over that kinetic energy, 1 - (v_end^2 - 2 g x_end) / V^2, x_end
            being the depth at which the impactor leaves: the same but along gravity, whose work to there is
            lost too.
        peak_displacement: greatest penetration [m].
        time_to_peak: [s]; infinite where there is no peak, and the five above are then those at the end.
    """

    K_tangent: Float[Array, " impact"]
    K_secant: Float[Array, " impact"]
    C_equivalent: Float[Array, " impact"]
    energy_lost: Float[Array, " impact"]
    energy_share: Float[Array, " impact"]
    peak_displacement: Float[Array, " impact"]
    time_to_peak: Float[Array, " impact"]


def comparables(
    element: str | Element,
    parameters: Parameters,
    mass: ArrayLike,
    velocity: ArrayLike,
    *,
    diameter: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
) -> Comparables:
    """Stiffnesses, damping and loss of impacts; arguments as of `bayestissue.elements.impact`.

    Raises:
        KeyError: there is no such element, or the parameters are not its own.
    """
    which, arguments = prepared(element, parameters, mass, velocity, diameter, gravity)
    return comparables_of(which, *arguments)


@partial(jax.jit, static_argnames="element")
def comparables_of(
    element: Element, p: dict[str, Array], mass: Float[Array, " impact"], velocity: Float[Array, " impact"]
) -> Comparables:
    """`comparables` of complete parameters, compiled: see `bayestissue.elements.element.complete`."""
    path, M, V = Path.solved(element, p, mass, velocity), mass, velocity
    peak = jnp.minimum(path.time_to_peak, path.duration)
    points = (jnp.asarray(_POINTS) + 1) / 2 * peak[:, None]
    leaves = jnp.minimum(path.leaves, path.duration)
    # In one go, since what follows the path is long to compile.
    states = path.at(jnp.concatenate([peak[:, None], leaves[:, None], points], axis=1))
    x, v, *inner_states = states[..., 0]
    s, end, last, fall = tuple(inner_states), states[0, :, 1], states[1, :, 1], falling(p)
    squares = (states[1, :, 2:] ** 2 @ jnp.asarray(_WEIGHTS)) * peak / 2
    spent = M * (V**2 - v**2) / 2 + M * fall * x - element.stored(x, v, s, p)
    return Comparables(
        _tangent(element, p, V),
        element.force(x, jnp.zeros_like(v), s, p) / x,
        spent / squares,
        1 - (last / V) ** 2,
        1 - (last**2 - 2 * fall * end) / V**2,
        x,
        path.time_to_peak,
    )


def _tangent(element: Element, p: dict[str, Array], velocity: Array) -> Array:
    """The force's slope in x with the internal lengths held, at contact.

    What remembers is slow: at contact its dampers have not yet yielded.
    """
    y = at_contact(element, velocity)
    s = tuple(y[2:])
    return jax.jvp(lambda x: element.force(x, velocity, s, p), (y[0],), (jnp.ones_like(y[0]),))[1]


# Between the nodes beside the greatest force. Nodes are 1 % of a contact apart, so that the force between two
# of these places is greater by less than 1e-6 of itself.
_BETWEEN = np.linspace(0.0, 1.0, 33)


class Peaks(NamedTuple):
    """The peaks of impacts, each [impact].

    Attributes:
        depth: greatest penetration [m].
        time: from contact to it [s]; infinite where there is none, and the depth is then that at the end.
        force: greatest force on the impactor [N]: M times the greatest F / M. Of a damper beside a
            spring it may be at contact.
    """

    depth: Float[Array, " impact"]
    time: Float[Array, " impact"]
    force: Float[Array, " impact"]


@partial(jax.jit, static_argnames="element")
def peaks_of(
    element: Element, p: dict[str, Array], mass: Float[Array, " impact"], velocity: Float[Array, " impact"]
) -> Peaks:
    """Peaks of impacts; arguments as of `bayestissue.elements.comparables.comparables_of`."""
    path = Path.solved(element, p, mass, velocity)

    def force(y: Array) -> Array:
        return mass[:, None] * deceleration_of(element, path.columns(), mass[:, None], y)

    times = path.nodes.time.T
    inside = times <= path.leaves[:, None]
    at_nodes = jnp.where(inside, force(jnp.moveaxis(path.nodes.y, 0, -1)), -jnp.inf)
    best = jnp.argmax(at_nodes, axis=1)[:, None]
    low, high = (
        jnp.take_along_axis(times, jnp.clip(best + step, 0, times.shape[1] - 1), axis=1) for step in (-1, 1)
    )
    peak = jnp.minimum(path.time_to_peak, path.duration)
    # In one go, since what follows the path is long to compile.
    y = path.at(jnp.concatenate([peak[:, None], low + jnp.asarray(_BETWEEN) * (high - low)], axis=1))
    return Peaks(y[0, :, 0], path.time_to_peak, force(y[..., 1:]).max(axis=1))
