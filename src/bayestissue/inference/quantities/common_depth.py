"""Force over depth at one depth that all impacts reach.

A spring that is not straight has another secant stiffness at every depth, and a heavier impactor goes deeper.
Force over depth at one depth that all impacts reach compares them: what differs between masses there is the
tissue's law, not the depth.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from bayestissue.inference.quantities.whole import Whole
from bayestissue.mechanics.elements.element import REFERENCE_DIAMETER_M, Element, Parameters
from bayestissue.model.likelihood.element.impact import MeasuredImpact


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
    arguments = {**dict(zip(names, measured.parameters, strict=True)), **record.surroundings}
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
