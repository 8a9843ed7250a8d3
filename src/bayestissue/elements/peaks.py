"""How deep, how hard and how soon: the peaks of an impact."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.elements.element import Element, deceleration_of
from bayestissue.elements.impact import Path

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
    path = Path.of(element, p, mass, velocity)

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
