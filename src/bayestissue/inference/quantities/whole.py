"""An impact on element and discrepancy together, as its recorded motion shows it; and K at a common depth.

A spring that is not straight has another secant stiffness at every depth, and a heavier impactor goes deeper.
Force over depth at one depth that all impacts reach compares them: what differs between masses there is the
tissue's law, not the depth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.base.impact_arrays import JaxPerImpact, JaxPerSample
from bayestissue.mechanics.elements.element import REFERENCE_DIAMETER_M, Element, Parameters
from bayestissue.model.likelihood.impact import MeasuredImpact
from bayestissue.model.likelihood.response import motion


class Whole(NamedTuple):
    """An impact on element and discrepancy together, until the greatest depth.

    Attributes:
        x: depth at the samples, and from the first one past the greatest depth on that depth [m].
        v: velocity there, 0 from then on [m/s].
        force: of the tissue there [N]: M a, a being the whole deceleration; where m moves along
            (M + m) a - m g.
        peak: greatest depth [m].
        time: from contact to it [s].
        greatest: force on the impactor [N], within what was recorded.
        damping: -(M + m) a' / (a - g) at the greatest depth [N s/m]. Of F = f(x) + C v that is C whatever the
            spring's law f, since there v = 0 and v' = g - a.
    """

    x: JaxPerSample
    v: JaxPerSample
    force: JaxPerSample
    peak: JaxPerImpact
    time: JaxPerImpact
    greatest: JaxPerImpact
    damping: JaxPerImpact

    @property
    def secant(self) -> JaxPerImpact:
        """Force over depth at the greatest depth [N/m]."""
        return self.force[:, -1] / self.peak


def whole_impact(measured: MeasuredImpact, delta: JaxPerSample, velocity_error: JaxPerImpact) -> Whole:
    """The motion under a = d + delta, the element's own less delta's integrals.

    The greatest depth is soon after, or before, the sample whose velocity is nearest to 0, in the window or a
    little past its end; a and its slope there are those of the parabola through three samples about it.

    Args:
        measured: the element's impact and its record.
        delta: the discrepancy [m/s^2].
        velocity_error: of the velocity at contact [m/s].
    """
    record = measured.record
    collision = replace(measured.collision, velocity=record.velocity + velocity_error)
    x, v, d = motion(collision, record)
    slower, nearer = integrals(delta, record.first_time, record.step())
    x, v, a = x - nearer, v - slower, d + delta
    last = jnp.argmin(jnp.where(record.inside(), jnp.abs(v), jnp.inf), axis=1)[:, None]

    def at(values: Array, inside: Array) -> Array:
        return jnp.take_along_axis(values, inside, axis=1)

    middle = jnp.clip(last, 1, record.n_samples[:, None] - 2)
    (before, here, after), (early, now, late) = (
        [at(values, middle + step) for step in (-1, 0, 1)] for values in (a, record.time())
    )
    ahead, behind = (after - here) / (late - now), (here - before) / (now - early)
    bend = 2 * (ahead - behind) / (late - early)
    slope = ahead - bend * (late - now) / 2
    depth, speed = at(x, last), at(v, last)
    since_middle = at(record.time(), last) - now
    rate = slope + bend * since_middle
    # Force over mass slows by gravity less than itself.
    fall = record.gravity[:, None]
    slows = at(a, last) - fall
    wait = speed / (slows + rate * (speed / slows) / 2)
    peak = depth + wait * (speed - wait * (slows / 2 + rate * wait / 6))
    later = since_middle + wait
    most, steeper = here + slope * later + bend * later**2 / 2, slope + bend * later
    mass, time = record.mass, now + later
    greatest = jnp.maximum(jnp.where(record.inside(), a, -jnp.inf).max(axis=1), most[:, 0])
    # One more place, so that the greatest depth is there also where the window's last sample comes before it.
    inside = jnp.arange(x.shape[1] + 1) <= last
    until = (
        jnp.where(inside, jnp.pad(values, ((0, 0), (0, 1))), end)
        for values, end in ((x, peak), (v, jnp.zeros_like(peak)), (a, most))
    )
    x, v, a = until
    moves = collision.inertia
    damping = -moves * (steeper / (most - fall))[:, 0]
    force = moves[:, None] * a - (moves - mass)[:, None] * fall
    return Whole(x, v, force, peak[:, 0], time[:, 0], mass * greatest, damping)


def integrals(
    delta: Float[Array, "*batch impact sample"], first_time: JaxPerImpact, step: Float[Array, "impact _"]
) -> tuple[Float[Array, "*batch impact sample"], Float[Array, "*batch impact sample"]]:
    """The velocity and the displacement that delta takes off: its first and second integral from contact.

    By trapezia; between contact and the first sample delta is taken as it is there. Past a row's end the
    values mean nothing.
    """
    first = first_time[:, None]
    begin = delta[..., :1]
    velocity = begin * first + _integral(delta, step)
    return velocity, begin * first**2 / 2 + _integral(velocity, step)


def _integral(values: Array, step: Array) -> Array:
    pieces = step * (values[..., 1:] + values[..., :-1]) / 2
    return jnp.pad(jnp.cumsum(pieces, axis=-1), [(0, 0)] * (values.ndim - 1) + [(1, 0)])


def static_force(element: Element, p: Parameters, depth: Array) -> Array:
    """The element's force at ``depth`` [m] and at rest, its internal lengths 0 [N]; all of them broadcast."""
    still = jnp.zeros_like(depth)
    return element.force(depth, still, (still,) * element.states, p)


def at_common_depth(element: Element, p: Parameters, depth: JaxPerImpact) -> JaxPerImpact:
    """F(x_c, 0) / x_c of an element's own law, under a ball of the reference diameter [N/m].

    Args:
        element: without a discrepancy beside it.
        p: its parameters by name.
        depth: x_c [m].
    """
    return static_force(element, _under_reference_ball(p, depth), depth) / depth


def _under_reference_ball(p: Parameters, like: Array) -> dict[str, Array]:
    return {**p, "diameter_m": jnp.full_like(like, REFERENCE_DIAMETER_M)}


def whole_at_common_depth(measured: MeasuredImpact, whole: Whole, depth: JaxPerImpact) -> JaxPerImpact:
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
    element, arguments = measured.element, measured.collision.parameters
    columns = {name: value[:, None] for name, value in arguments.items()}
    here, most = _viscous(element, columns, whole.x), _viscous(element, columns, whole.peak[:, None])
    share = jnp.where(most > 0, here / jnp.where(most > 0, most, 1.0), 1.0)
    static = whole.force - whole.damping[:, None] * share * whole.v
    reached = jnp.minimum(depth, whole.peak)
    force = jax.vmap(jnp.interp)(reached, whole.x, static)
    reference = static_force(element, _under_reference_ball(arguments, depth), depth)
    return force / reached * reference / static_force(element, arguments, depth)


def _viscous(element: Element, p: Parameters, x: Array) -> Array:
    """The force that a velocity of 1 m/s adds [N]."""
    still = jnp.zeros_like(x)
    states = (still,) * element.states
    return element.force(x, still + 1.0, states, p) - element.force(x, still, states, p)
