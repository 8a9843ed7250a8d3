"""What an impact comes to: stiffness, damping and loss that mean the same for every element, and peaks."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float
from scipy.constants import g as standard_gravity

from bayestissue.base.impact_arrays import JaxPerImpact
from bayestissue.base.outcome_table import OUTCOMES
from bayestissue.mechanics.elements.element import GRAVITY, Collision, Element, Outcomes, Parameters
from bayestissue.mechanics.elements.head_injury import SEARCH, head_injury, pulse_of
from bayestissue.mechanics.elements.library import element as named
from bayestissue.mechanics.elements.whole_impact import LONG, Path

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(16)
# Between the nodes beside the greatest force or jerk, which are 1 % of a contact apart.
_BETWEEN = np.linspace(0.0, 1.0, 17)


def outcomes(
    element: str | Element,
    parameters: Parameters,
    mass: ArrayLike,
    velocity: ArrayLike,
    *,
    diameter: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    headform: bool = False,
) -> Outcomes:
    """What impacts come to, by name, each [impact]; arguments as of `elements.whole_impact`.

    They are those of ``base/outcomes.toml``, where their formulas stand too, of a ``headform`` its own too;
    and what all elements share of stiffness, damping and loss:

    - K_tangent: slope of the force that comes with penetration at contact, a damper's own force left out
      [N/m];
    - K_secant: force over penetration where penetration is greatest and the velocity 0 [N/m];
    - C_equivalent: of the damper beside the spring that would have lost the same energy from contact to
      peak: (M V^2 / 2 + M g x - energy stored at the peak) / integral of x'^2 [N s/m]. Where tissue moves
      along, of the energy just after it was taken along, M V^2 / 2 times M / (M + m);
    - energy_lost: 1 - (v_e / V)^2, v_e being the velocity at which the impactor leaves: the share of its
      kinetic energy at contact that it has not got back.

    Where there is no greatest penetration, or the tissue is never left, what is said of that moment is said
    of the end instead, when the impactor has come to rest: 8 pi (M / K)^1/2 after contact, M being all that
    moves. A Maxwell tissue yields for ever under a weight; there, x_e, the depth at which the impactor
    leaves, is that of this time. What is never left has velocity 0 there. The blow in which tissue is taken
    along comes before the greatest force; the jump of a damper's force at contact, whose rate is infinite,
    before the greatest jerk and the head injury criteria.

    Raises:
        KeyError: there is no such element, or the parameters are not its own.
    """
    collision = Collision.of(named(element), parameters, mass, velocity, diameter=diameter, gravity=gravity)
    return outcomes_of(collision, headform=headform)


@partial(jax.jit, static_argnames="headform")
def outcomes_of(collision: Collision, *, headform: bool = False) -> Outcomes:
    """`outcomes`, compiled."""
    p, closed_form, path = collision.parameters, collision.element.level_outcomes, None
    comes: Outcomes = {}
    if closed_form and GRAVITY not in p:
        comes = _with_ratios(closed_form(p, collision.mass, collision.velocity), collision)
    if not {*OUTCOMES} <= {*comes}:
        path = Path.solved(collision)
        comes = _with_ratios(_of_path(path), collision) | comes
    if not headform:
        return comes
    longest = LONG * jnp.sqrt(collision.inertia / p["K"])
    window = jnp.minimum(SEARCH.times_to_peak * comes["time_to_peak"], longest)
    end = jnp.minimum(comes["contact_duration"], window)
    return comes | head_injury(pulse_of(collision, end, path and path.nodes))


def _with_ratios(comes: Outcomes, collision: Collision) -> Outcomes:
    """With the outcomes that follow from others, mass and velocity at contact."""
    M, V = collision.mass, collision.velocity
    return comes | {
        "peak_deceleration": comes["peak_force"] / (M * standard_gravity),
        "restitution": comes["rebound_velocity"] / V,
        "energy_absorbed": comes["energy_share"] * M * V**2 / 2,
    }


def _of_path(path: Path) -> Outcomes:
    """Of a solved path."""
    collision, columns = path.collision, path.collision.columns()
    element, p, M, V = collision.element, collision.parameters, collision.mass, collision.velocity

    def jerks(y: Array) -> Array:
        return jnp.abs(jax.jvp(columns.deceleration, (y,), (columns.rates(y),))[1])

    times, nodes = path.nodes.time.T, jnp.moveaxis(path.nodes.y, 0, -1)
    peak, leaves = (jnp.minimum(when, path.duration) for when in (path.time_to_peak, path.leaves))

    def beside_greatest(values: Array) -> Array:
        """Times close about the node whose value is greatest."""
        best = jnp.argmax(jnp.where(times <= path.leaves[:, None], values, -jnp.inf), axis=1)[:, None]
        low, high = (
            jnp.take_along_axis(times, jnp.clip(best + step, 0, times.shape[1] - 1), axis=1)
            for step in (-1, 1)
        )
        return jnp.minimum(low + jnp.asarray(_BETWEEN) * (high - low), leaves[:, None])

    squares_at = (jnp.asarray(_POINTS) + 1) / 2 * peak[:, None]
    parts = [
        *(peak[:, None], leaves[:, None], squares_at),
        *(beside_greatest(quantity(nodes)) for quantity in (columns.deceleration, jerks)),
    ]
    # In one go, since what follows the path is long to compile.
    states = path.at(jnp.concatenate(parts, axis=1))
    at_peak, at_leaving, within, hardest, fastest = jnp.split(
        states, np.cumsum([part.shape[1] for part in parts])[:-1], axis=-1
    )
    x, v, *inner_states = at_peak[..., 0]
    s, end, fall = tuple(inner_states), at_leaving[0, :, 0], collision.gravity
    # What is never left gives nothing back, also where the impactor has not come to rest when the path ends.
    last = jnp.where(jnp.isinf(path.leaves), 0.0, at_leaving[1, :, 0])
    squares = (within[1] ** 2 @ jnp.asarray(_WEIGHTS)) * peak / 2
    # Of 0 m/s^2 nothing, however long.
    fallen = jnp.where(fall == 0, 0.0, fall * path.leaves)
    begins, moves = collision.impactor_share * V, collision.inertia
    spent = moves * (begins**2 - v**2) / 2 + M * fall * x - element.stored(x, v, s, p)
    return {
        "K_tangent": tangent_stiffness(element, p),
        "K_secant": element.force(x, jnp.zeros_like(v), s, p) / x,
        "C_equivalent": spent / squares,
        "energy_lost": 1 - (last / V) ** 2,
        "energy_share": 1 - (last**2 - 2 * fall * end) / V**2,
        "energy_share_with_gravity": 1 - last**2 / (V**2 + 2 * fall * end),
        "peak_depth": x,
        "time_to_peak": path.time_to_peak,
        "peak_force": M * greatest(columns.deceleration(hardest)),
        "contact_duration": path.leaves,
        "rebound_velocity": -last,
        "impulse": M * (V - last + fallen),
        "peak_jerk": greatest(jerks(fastest)),
    }


def greatest(values: Float[Array, "impact place"]) -> JaxPerImpact:
    """The greatest of values at even places: of the parabola through the greatest and its neighbours."""
    best = jnp.clip(jnp.argmax(values, axis=1), 1, values.shape[1] - 2)[:, None]
    before, here, after = (jnp.take_along_axis(values, best + step, axis=1)[:, 0] for step in (-1, 0, 1))
    bend, half = 2 * here - before - after, (after - before) / 2
    inside = jnp.abs(half) < bend
    return jnp.maximum(
        values.max(axis=1), here + jnp.where(inside, half**2 / (2 * jnp.where(inside, bend, 1.0)), 0.0)
    )


def tangent_stiffness(element: Element, p: Parameters) -> Array:
    """The force's slope in x with the internal lengths held, at the surface and at rest.

    What remembers is slow: at contact its dampers have not yet yielded. At rest no damper pushes, not even
    one that acts with depth.
    """
    still = jnp.zeros_like(p["K"])
    inner = (still,) * element.states
    return jax.jvp(lambda x: element.force(x, still, inner, p), (still,), (jnp.ones_like(still),))[1]
