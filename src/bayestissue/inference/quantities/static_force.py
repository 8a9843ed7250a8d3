"""Force over depth at one depth: the stiffness that impacts of different depth can be compared by.

A spring that is not straight has another secant stiffness at every depth, and a heavier impactor goes deeper.
At one depth that all impacts reach, what differs between masses is the tissue's law, not the depth.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.elements.element import REFERENCE_DIAMETER_M, Element, Parameters
from bayestissue.likelihood.element.discrepancy import integrals
from bayestissue.likelihood.element.impact import MeasuredImpact
from bayestissue.likelihood.element.response import motion


def static_force(element: Element, p: Parameters, depth: Array) -> Array:
    """The element's force at ``depth`` [m] and at rest, its internal lengths 0 [N]; all of them broadcast."""
    still = jnp.zeros_like(depth)
    return element.force(depth, still, (still,) * element.states, p)


def at_common_depth(
    element: Element, p: Parameters, depth: Float[Array, " impact"]
) -> Float[Array, " impact"]:
    """F(x_c, 0) / x_c of an element's own law, under a ball of the reference diameter [N/m].

    Args:
        element: without a discrepancy beside it.
        p: its parameters by name.
        depth: x_c [m].
    """
    return static_force(element, _under_reference_ball(p, depth), depth) / depth


def _under_reference_ball(p: Parameters, like: Array) -> dict[str, Array]:
    return {**p, "diameter_m": jnp.full_like(like, REFERENCE_DIAMETER_M)}


class Whole(NamedTuple):
    """An impact on element and discrepancy together, until the greatest depth.

    Attributes:
        x: depth at the samples, and from the first one past the greatest depth on that depth [m].
        v: velocity there, 0 from then on [m/s].
        force: M a there, a being the whole deceleration [N].
        peak: greatest depth [m].
        damping: -M a' / (a - g) at the greatest depth [N s/m]. Of F = f(x) + C v that is C whatever the
            spring's law f, since there v = 0 and v' = g - a.
    """

    x: Float[Array, "impact sample"]
    v: Float[Array, "impact sample"]
    force: Float[Array, "impact sample"]
    peak: Float[Array, " impact"]
    damping: Float[Array, " impact"]

    @property
    def secant(self) -> Float[Array, " impact"]:
        """Force over depth at the greatest depth [N/m]."""
        return self.force[:, -1] / self.peak


def whole_impact(
    measured: MeasuredImpact, delta: Float[Array, "impact sample"], velocity_error: Float[Array, " impact"]
) -> Whole:
    """The motion under F / M = a = d + delta, the element's own less delta's integrals.

    The greatest depth is soon after, or before, the sample whose velocity is nearest to 0, in the window or a
    little past its end; a and its slope there are those of the parabola through three samples about it.

    Args:
        measured: the element's impact and its record.
        delta: the discrepancy [m/s^2].
        velocity_error: of the velocity at contact [m/s].
    """
    record = measured.record
    own = motion(measured.element, measured.parameters, record, record.velocity + velocity_error)
    slower, nearer = integrals(delta, record.first_time, record.dt)
    x, v, a = own.x - nearer, own.v - slower, own.d + delta
    last = jnp.argmin(jnp.where(record.inside(), jnp.abs(v), jnp.inf), axis=1)[:, None]

    def at(values: Array, place: Array) -> Array:
        return jnp.take_along_axis(values, place, axis=1)

    middle = jnp.clip(last, 1, record.n_samples[:, None] - 2)
    before, here, after = (at(a, middle + step) for step in (-1, 0, 1))
    step = record.dt[:, None]
    slope, bend = (after - before) / (2 * step), (after - 2 * here + before) / step**2
    depth, speed = at(x, last), at(v, last)
    rate = slope + bend * (last - middle) * step
    # Force over mass slows by gravity less than itself.
    fall = 0.0 if record.gravity is None else record.gravity[:, None]
    slows = at(a, last) - fall
    wait = speed / (slows + rate * (speed / slows) / 2)
    peak = depth + wait * (speed - wait * (slows / 2 + rate * wait / 6))
    later = (last - middle) * step + wait
    most, steeper = here + slope * later + bend * later**2 / 2, slope + bend * later
    # One more place, so that the greatest depth is there also where the window's last sample comes before it.
    place = jnp.arange(x.shape[1] + 1) <= last
    until = (
        jnp.where(place, jnp.pad(values, ((0, 0), (0, 1))), end)
        for values, end in ((x, peak), (v, jnp.zeros_like(peak)), (a, most))
    )
    x, v, a = until
    mass = record.mass
    return Whole(x, v, mass[:, None] * a, peak[:, 0], -mass * (steeper / (most - fall))[:, 0])


def whole_at_common_depth(
    measured: MeasuredImpact, whole: Whole, depth: Float[Array, " impact"]
) -> Float[Array, " impact"]:
    """(F - C v) / x_c when the depth first is x_c, F being element's and discrepancy's force together [N/m].

    C is `Whole.damping`: a record of one stroke tells a spring of unknown law from a damper by the force's
    slope at the greatest depth alone. Where the element's damper is not the same at all depths, C goes with
    depth as the element has it, and where the element's force grows with the impactor's diameter it is taken
    to the reference diameter as the element has it. An impact that goes less deep, as a draw may have it, has
    its own greatest depth for x_c.

    Args:
        measured: as of `whole_impact`.
        whole: what that returned.
        depth: x_c [m].
    """
    element, record = measured.element, measured.record
    names = (parameter.name for parameter in element.parameters)
    own = {**dict(zip(names, measured.parameters, strict=True)), "diameter_m": record.diameter}
    columns = {name: value[:, None] for name, value in own.items()}
    here, most = _viscous(element, columns, whole.x), _viscous(element, columns, whole.peak[:, None])
    share = jnp.where(most > 0, here / jnp.where(most > 0, most, 1.0), 1.0)
    static = whole.force - whole.damping[:, None] * share * whole.v
    reached = jnp.minimum(depth, whole.peak)
    force = jax.vmap(jnp.interp)(reached, whole.x, static)
    reference = static_force(element, _under_reference_ball(own, depth), depth)
    return force / reached * reference / static_force(element, own, depth)


def _viscous(element: Element, p: Parameters, x: Array) -> Array:
    """The force that a velocity of 1 m/s adds [N]."""
    still = jnp.zeros_like(x)
    states = (still,) * element.states
    return element.force(x, still + 1.0, states, p) - element.force(x, still, states, p)
