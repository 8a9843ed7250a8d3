"""Any element by a Runge-Kutta method of fifth order (Tsitouras 2011) in diffrax, all impacts side by side.

Steps are fixed beforehand, so that value and derivatives take one and the same path. Between steps the state
is the cubic through states and rates at both ends; its error, of fourth order in the step, is the larger.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerImpact
from bayestissue.mechanics.elements.element import Collision

# At least so many steps over a trace, where it has as many samples.
STEPS = 64


class Nodes(NamedTuple):
    """States at the ends of steps.

    Attributes:
        time: s.
        y: the state.
        slope: dy/dt.
    """

    time: Float[Array, "node impact"]
    y: Float[Array, "node state impact"]
    slope: Float[Array, "node state impact"]


def nodes(
    collision: Collision,
    duration: JaxPerImpact,
    fractions: Float[np.ndarray, " node"],
    *,
    flies_off: bool = False,
    start: Float[Array, "state impact"] | None = None,
) -> Nodes:
    """The states at fractions of a duration, one step from each to the next.

    Args:
        collision: the impacts.
        duration: of the whole [s].
        fractions: from 0 to 1.
        start: the state at the beginning, that at contact unless given.
        flies_off: leave the impactor to itself before the surface, where no element pushes.
    """
    # Most of a second to import, and only elements that are not linear need it.
    import diffrax

    def rates(collision: Collision, y: Array) -> Array:
        derivative = collision.rates(y)
        if not flies_off:
            return derivative
        return derivative.at[1].set(jnp.where(y[0] < 0, collision.gravity, derivative[1]))

    def field(t: Any, y: Array, args: tuple[Collision, Array]) -> Array:
        collision, duration = args
        return duration * rates(collision, y)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Tsit5(),
        t0=0.0,
        t1=1.0,
        dt0=None,
        y0=collision.at_contact() if start is None else start,
        args=(collision, duration),
        stepsize_controller=diffrax.StepTo(ts=jnp.asarray(fractions)),
        saveat=diffrax.SaveAt(t0=True, steps=True),
        adjoint=diffrax.ForwardMode(),
        max_steps=len(fractions) - 1,
    )
    time, y = jnp.asarray(fractions)[:, None] * duration, solution.ys
    solved = Nodes(time, y, jnp.moveaxis(rates(collision, jnp.moveaxis(y, 1, 0)), 0, 1))
    return _pushed_to_the_surface(collision, solved) if flies_off else solved


def _pushed_to_the_surface(collision: Collision, nodes: Nodes) -> Nodes:
    """The nodes with the first one beyond the surface as it would be if the law held there too.

    A force that ends at the surface bends there. A cubic over that bend would err by more than all other
    steps together, and its slopes in the parameters by hundreds of times that.
    """
    is_beyond = nodes.y[:, 0] < 0
    beyond = jnp.maximum(jnp.argmax(is_beyond, axis=0), 1)
    impact = jnp.arange(beyond.shape[0])
    step = nodes.time[beyond, impact] - nodes.time[beyond - 1, impact]

    # The method of Runge and Kutta, of fourth order.
    start = nodes.y[beyond - 1, :, impact].T
    first = collision.rates(start)
    second = collision.rates(start + step / 2 * first)
    third = collision.rates(start + step / 2 * second)
    last = collision.rates(start + step * third)
    end = start + step / 6 * (first + 2 * second + 2 * third + last)
    here = (jnp.arange(len(is_beyond))[:, None] == beyond) & is_beyond
    return nodes._replace(
        y=jnp.where(here[:, None], end, nodes.y),
        slope=jnp.where(here[:, None], collision.rates(end), nodes.slope),
    )


def even_grid(
    collision: Collision, first_time: JaxPerImpact, dt: JaxPerImpact, count: int
) -> Float[Array, "state impact sample"]:
    """The state at first_time + k dt, k = 0 ... count - 1; at contact where first_time is negative.

    A step is a whole number of samples, so that every step is read at the same fractions of it.
    """
    size = max(1, count // STEPS)
    number = -(-count // size)
    # Short steps first, as a Hertz force has no smooth start.
    before = nodes(collision, jnp.maximum(first_time, 0.0), np.linspace(0.0, 1.0, 6) ** 2)
    even = np.linspace(0.0, 1.0, number + 1)
    steps = nodes(collision, number * size * dt, even, start=before.y[-1])
    into = jnp.broadcast_to(jnp.arange(size) / size, (dt.shape[0], size))
    step = (size * dt)[:, None]
    values, slopes = steps.y[..., None], steps.slope[..., None]
    y = cubic((values[:-1], values[1:]), (slopes[:-1], slopes[1:]), into, step)
    # [step, state, impact, sample of the step]
    y = jnp.transpose(y, (1, 2, 0, 3))
    return y.reshape(*y.shape[:2], -1)[..., :count]


def at_times(nodes: Nodes, time: Float[Array, "impact time"]) -> Float[Array, "state impact time"]:
    """The state at any times between the first node and the last."""
    index = jax.vmap(jnp.searchsorted, in_axes=(1, 0))(nodes.time[1:-1], time)
    impact = jnp.arange(time.shape[0])[:, None]
    begin, end = (nodes.time[index + k, impact] for k in (0, 1))
    values, slopes = (
        (jnp.moveaxis(part[index, :, impact], -1, 0), jnp.moveaxis(part[index + 1, :, impact], -1, 0))
        for part in (nodes.y, nodes.slope)
    )
    return cubic(values, slopes, (time - begin) / (end - begin), end - begin)


def between_steps(
    values: Float[Array, "*batch step"],
    slopes: Float[Array, "*batch step"],
    at: Float[Array, "*batch place"],
    step: Array,
) -> Float[Array, "*batch place"]:
    """The cubic through values and slopes at even steps, ``at`` so many of these after the first."""
    index = jnp.clip(at.astype(int), 0, values.shape[-1] - 2)
    (value, slope), (next_value, next_slope) = (
        [jnp.take_along_axis(part, index + k, axis=-1) for part in (values, slopes)] for k in (0, 1)
    )
    return cubic((value, next_value), (slope, next_slope), at - index, step)


def cubic(values: tuple[Array, Array], slopes: tuple[Array, Array], into: Array, step: Array) -> Array:
    """The cubic with these values and slopes at both ends of a step, at the fraction ``into`` of it."""
    run = values[1] - values[0]
    bent = (1 - into) * (step * slopes[0] - run) - into * (step * slopes[1] - run)
    return values[0] + into * run + into * (1 - into) * bent


def cubic_slope(values: tuple[Array, Array], slopes: tuple[Array, Array], into: Array, step: Array) -> Array:
    """The slope of `cubic` there."""
    run = values[1] - values[0]
    here, there = step * slopes[0] - run, step * slopes[1] - run
    bent = (1 - into) * (1 - 3 * into) * here - into * (2 - 3 * into) * there
    return (run + bent) / step
