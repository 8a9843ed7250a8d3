"""An impact on element and discrepancy together, as its recorded motion shows it."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.mechanics.elements.element import inertia
from bayestissue.model.likelihood.element.impact import MeasuredImpact
from bayestissue.model.likelihood.element.response import motion


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

    x: Float[Array, "impact sample"]
    v: Float[Array, "impact sample"]
    force: Float[Array, "impact sample"]
    peak: Float[Array, " impact"]
    time: Float[Array, " impact"]
    greatest: Float[Array, " impact"]
    damping: Float[Array, " impact"]

    @property
    def secant(self) -> Float[Array, " impact"]:
        """Force over depth at the greatest depth [N/m]."""
        return self.force[:, -1] / self.peak


def whole_impact(
    measured: MeasuredImpact, delta: Float[Array, "impact sample"], velocity_error: Float[Array, " impact"]
) -> Whole:
    """The motion under a = d + delta, the element's own less delta's integrals.

    The greatest depth is soon after, or before, the sample whose velocity is nearest to 0, in the window or a
    little past its end; a and its slope there are those of the parabola through three samples about it.

    Args:
        measured: the element's impact and its record.
        delta: the discrepancy [m/s^2].
        velocity_error: of the velocity at contact [m/s].
    """
    record = measured.record
    element_motion = motion(measured.element, measured.parameters, record, record.velocity + velocity_error)
    slower, nearer = integrals(delta, record.first_time, record.step())
    x, v, a = element_motion.x - nearer, element_motion.v - slower, element_motion.d + delta
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
    names = (parameter.name for parameter in measured.element.parameters)
    moves = inertia(measured.element, dict(zip(names, measured.parameters, strict=True)), mass)
    damping = -moves * (steeper / (most - fall))[:, 0]
    force = moves[:, None] * a - (moves - mass)[:, None] * fall
    return Whole(x, v, force, peak[:, 0], time[:, 0], mass * greatest, damping)


def integrals(
    delta: Float[Array, "*batch impact sample"],
    first_time: Float[Array, " impact"],
    step: Float[Array, "impact _"],
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
