"""A whole impact on an element: M x'' = M g - F(x, x', internal lengths), x(0) = 0, x'(0) = V.

Where tissue of mass m moves along, (M + m) x'' = M g - F from x'(0) = V M / (M + m) on.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerSample
from bayestissue.mechanics.elements import linear, solver
from bayestissue.mechanics.elements.element import Collision, Element, Parameters
from bayestissue.mechanics.elements.library import element as named

# Steps are short at contact, where a Hertz force has no smooth start, and grow with its square root.
NODES = 401
# Of 1 / omega_n: four times the contact of an undamped spring K.
LONG = 8 * np.pi
# Newton steps follow: these need only come near, also where a force fades out without a slope.
_BISECTIONS = 20

Quantity = Callable[[Array], Array]


class ImpactorPath(NamedTuple):
    """The impactor's path, and when it was deepest and when it left.

    Attributes:
        x: into the tissue [m].
        v: its velocity [m/s].
        deceleration: force on the impactor over M while the tissue pushes, else 0 [m/s^2]: what a sensor
            reads that is 0 in free fall. The blow with which a moving mass is taken along is not in it.
        time_to_peak: from contact to the greatest x [s]; infinite where there is none.
        leaves: from contact to where the force is 0 [s]; infinite where it never is. What falls back on the
            tissue after that is not followed.
    """

    x: JaxPerSample
    v: JaxPerSample
    deceleration: JaxPerSample
    time_to_peak: JaxPerImpact
    leaves: JaxPerImpact


def impact(
    element: str | Element,
    parameters: Parameters,
    mass: ArrayLike,
    velocity: ArrayLike,
    time: JaxPerSample,
    *,
    diameter: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
) -> ImpactorPath:
    """Simulate impacts, from flight before contact to flight after it.

    Linear elements by matrix exponentials, others by `bayestissue.mechanics.elements.solver` to about 1e-7 of
    the peak. Differentiable forwards (`jax.jvp`, `jax.jacfwd`).

    Args:
        element: an element or its name.
        parameters: of the element, by name; each [impact] or a number.
        mass: M [kg], [impact] or a number.
        velocity: V at contact [m/s], likewise.
        time: since contact [s]; before it negative.
        diameter: of the impactor [m]; the reference diameter unless given.
        gravity: g, the part of gravity along the motion [m/s^2], positive into the tissue; none unless given.

    Raises:
        KeyError: there is no such element, or the parameters are not its own.
    """
    time = jnp.asarray(time, float)
    met = named(element), parameters, mass, velocity
    return _impact(Collision.of(*met, diameter=diameter, gravity=gravity, shape=time.shape[:1]), time)


@jax.jit
def _impact(collision: Collision, time: Array) -> ImpactorPath:
    path = Path.solved(collision, time.max(-1))
    columns = collision.columns()
    since = jnp.clip(time, 0.0, jnp.minimum(path.leaves, path.duration)[:, None])
    y = path.at(since)
    inside = (time >= 0) & (time <= path.leaves[:, None])
    d = columns.deceleration(y)
    flight, fall = time - since, columns.gravity
    # At contact, where tissue is taken along, the velocity is another before than after.
    flies = jnp.where(time < 0, columns.velocity, y[1])
    x, v = y[0] + flies * flight + fall * flight**2 / 2, flies + fall * flight
    return ImpactorPath(x, v, jnp.where(inside, d, 0.0), path.time_to_peak, path.leaves)


class Path(NamedTuple):
    """An impact that can be asked for its state at any time in contact."""

    collision: Collision
    duration: JaxPerImpact
    nodes: solver.Nodes
    time_to_peak: JaxPerImpact
    leaves: JaxPerImpact

    @classmethod
    def solved(cls, collision: Collision, until: ArrayLike = 0.0) -> Path:
        """The path from contact to ``until`` [s], or to four times an undamped contact if that is later."""
        undamped = LONG * jnp.sqrt(collision.inertia / collision.parameters["K"])
        duration = jax.lax.stop_gradient(jnp.maximum(until, undamped))
        if collision.element.linear:
            nodes = _linear_nodes(collision, duration)
        else:
            fractions = np.linspace(0.0, 1.0, NODES) ** 2
            nodes = solver.nodes(collision, duration, fractions, flies_off=True)
        path = cls(collision, duration, nodes, duration, duration)
        peak, leaves = path.first(lambda y: y[1], collision.columns().deceleration)
        return path._replace(time_to_peak=peak, leaves=leaves)

    def at(self, time: Float[Array, "impact time"]) -> Float[Array, "state impact time"]:
        """The state at times from contact on, within the duration."""
        if self.collision.element.linear:
            return linear.at_times(self.collision, time)
        return solver.at_times(self.nodes, time)

    def first(self, *quantities: Quantity) -> Float[Array, "quantity impact"]:
        """When each quantity of the state, [impact, time], first falls to 0; infinite if it never does.

        They are sought together, since what follows the path is long to compile.
        """

        def at_own_times(y: Float[Array, "state impact quantity"]) -> Float[Array, "impact quantity"]:
            """Every quantity at a time of its own."""
            values = [quantity(y[..., k : k + 1])[:, 0] for k, quantity in enumerate(quantities)]
            return jnp.stack(values, axis=-1)

        nodes = jnp.moveaxis(self.nodes.y, 0, -1)
        past = jnp.stack([quantity(nodes) for quantity in quantities], axis=1)[..., 1:] <= 0
        end = jnp.argmax(past, axis=-1)
        impact = jnp.arange(end.shape[0])[:, None]
        low, high = self.nodes.time[end, impact], self.nodes.time[end + 1, impact]

        def halve(_: int, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = bracket
            middle = (low + high) / 2
            after = at_own_times(solver.at_times(self.nodes, middle)) <= 0
            return jnp.where(after, low, middle), jnp.where(after, middle, high)

        low, _ = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high))

        def newton(_: int, when: Array) -> Array:
            value, slope = jax.jvp(lambda t: at_own_times(self.at(t)), (when,), (jnp.ones_like(when),))
            falls = slope < 0
            return when - jnp.where(falls, value / jnp.where(falls, slope, 1.0), 0.0)

        # Newton's step also gives the time its derivatives, by the implicit function theorem.
        when = jax.lax.fori_loop(0, 2, newton, jax.lax.stop_gradient(low))
        return jnp.where(past.any(axis=-1), when, jnp.inf).T


@partial(jax.jit, static_argnames="places")
def loops_of(collision: Collision, places: int) -> dict[str, Float[Array, "impact place"]]:
    """Force over depth at ``places`` even times in to the greatest depth, and out until the impactor leaves.

    Between the nodes of its path, an impact is the cubic of `solver.at_times`, also of a linear element. A
    tissue that is never left is followed to the end of the path; depths that then rise again are NaN. Of an
    impactor that has no greatest depth the way out is one point, where it comes to rest.

    Returns:
        ``depth_in`` [m], growing, and ``force_in``, the force on the impactor there [N]; ``depth_out``, which
        falls, and ``force_out``.
    """
    path = Path.solved(collision)
    peak, end = (jnp.minimum(when, path.duration)[:, None] for when in (path.time_to_peak, path.leaves))
    share = jnp.linspace(0.0, 1.0, places)
    times = jnp.concatenate([peak * share, peak + (end - peak) * share], axis=1)
    y = solver.at_times(path.nodes, times)
    force = collision.mass[:, None] * collision.columns().deceleration(y)
    # The greatest depth to rounding, from which depths of a motion that does not leave may rise again.
    out = y[0][:, places:]
    falls = jax.lax.cummin(out, axis=1) == out
    out, pushed = (jnp.where(falls, part, jnp.nan) for part in (out, force[:, places:]))
    inward = {"depth_in": y[0][:, :places], "force_in": force[:, :places]}
    return inward | {"depth_out": out, "force_out": pushed}


def _linear_nodes(collision: Collision, duration: Array) -> solver.Nodes:
    """Even nodes, so that each is the one before it times one matrix."""
    start = jnp.zeros_like(duration)
    y = linear.even_grid(collision, start, duration / (NODES - 1), NODES)
    slope = collision.columns().rates(y)
    time = jnp.linspace(0.0, 1.0, NODES)[:, None] * duration
    return solver.Nodes(time, jnp.moveaxis(y, -1, 0), jnp.moveaxis(slope, -1, 0))
