"""The head injury criterion of a headform's impact: its longest and hardest push, weighed as heads bear it.

HIC = max over t1 < t2 of (t2 - t1) [(1 / (t2 - t1)) integral of a dt]^2.5, a = F / M in units of standard
gravity and t2 - t1 at most 15 or 36 ms (49 CFR 571.208, S6.2). The integral is the velocity that the force
has taken, v1 - v2 + g (t2 - t1), so that no quadrature is made: only the two moments are sought.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.constants import g as standard_gravity

from bayestissue.base.impact_arrays import JaxPerImpact
from bayestissue.mechanics.elements import linear, solver
from bayestissue.mechanics.elements.element import Collision

# What a run calls an impactor that stands for a head.
HEADFORM = "headform"
# The longest window of each criterion [s].
LONGEST = {"HIC15": 0.015, "HIC36": 0.036}


@dataclass(frozen=True)
class WindowSearch:
    """How the best window is sought.

    Attributes:
        times_to_peak: how long a pulse is followed, of the time to the greatest depth: one that is never left
            comes to rest after that.
        steps: of the pulse, between which the cubic through velocity and deceleration stands for it.
        windows: begins and ends of the first windows over the whole contact.
        rounds: how often the distance between the windows about the best is halved.
        neighbours: windows on either side of the best in each round.
    """

    times_to_peak: float = 4.0
    steps: int = 128
    windows: int = 16
    rounds: int = 11
    neighbours: int = 1


SEARCH = WindowSearch()


class Pulse(NamedTuple):
    """The force of a contact over mass, on even steps.

    Attributes:
        end: of contact [s].
        left: velocity that the force has left, v - g t [m/s].
        deceleration: F / M, with which it falls [m/s^2].
    """

    end: JaxPerImpact
    left: Float[Array, "impact step"]
    deceleration: Float[Array, "impact step"]

    def at(self, time: Float[Array, "impact time"]) -> Float[Array, "impact time"]:
        """``left`` at any times of the contact."""
        step = self.end[:, None] / SEARCH.steps
        return solver.between_steps(self.left, -self.deceleration, time / step, step)


def pulse_of(collision: Collision, end: JaxPerImpact, nodes: solver.Nodes | None) -> Pulse:
    """The pulse until ``end``; of an element that is not linear from the ``nodes`` of its path."""
    time = jnp.linspace(0.0, 1.0, SEARCH.steps + 1) * end[:, None]
    if nodes is None or collision.element.linear:
        step = end / SEARCH.steps
        y = linear.even_grid(collision, jnp.zeros_like(end), step, SEARCH.steps + 1)
    else:
        y = solver.at_times(nodes, time)
    columns = collision.columns()
    return Pulse(end, y[1] - columns.gravity * time, columns.deceleration(y))


def head_injury(pulse: Pulse) -> dict[str, JaxPerImpact]:
    """Each criterion of `LONGEST` [g^2.5 s]."""
    criteria = jax.vmap(_greatest, in_axes=(None, 0))(pulse, jnp.asarray(list(LONGEST.values())))
    return dict(zip(LONGEST, criteria, strict=True))


def _greatest(pulse: Pulse, longest: Float[Array, ""]) -> JaxPerImpact:
    """Windows all over the contact, and then about the best of them, ever closer.

    Beside windows with both moments on the grid there is one of full length from each beginning, so that the
    bound on the length is met exactly.
    """
    end = pulse.end[:, None]

    def best(begin: Array, stop: Array) -> tuple[Array, Array, Array]:
        """The best window's moments and its criterion, of all begins and stops [impact, moment]."""
        full = jnp.minimum(begin + longest, end)

        def candidates(of_stop: Array, of_full: Array) -> Array:
            """[impact, begin, stop], the full length last."""
            shape = (*begin.shape, stop.shape[1])
            return jnp.concatenate([jnp.broadcast_to(of_stop[:, None], shape), of_full[:, :, None]], axis=2)

        stops = candidates(stop, full)
        length = stops - begin[:, :, None]
        speed = pulse.at(begin)[:, :, None] - candidates(pulse.at(stop), pulse.at(full))
        # Rounding must not take the full length away.
        fits = (length > 0) & (length <= longest * (1 + 1e-12))
        criteria = jnp.where(fits, (speed / standard_gravity) ** 5 / jnp.where(fits, length, 1.0) ** 3, 0.0)
        stops, criteria = (values.reshape(len(begin), -1) for values in (stops, criteria))
        which = jnp.argmax(criteria, axis=1)[:, None]
        first = jnp.take_along_axis(begin, which // (stop.shape[1] + 1), axis=1)
        return first, jnp.take_along_axis(stops, which, axis=1), jnp.sqrt(criteria.max(axis=1))

    def closer(round_: Array, window: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        step = end / SEARCH.windows / 2.0 ** (round_ + 1)
        offsets = np.arange(-SEARCH.neighbours, SEARCH.neighbours + 1) * step
        return best(*(jnp.clip(moment + offsets, 0.0, end) for moment in window[:2]))

    grid = jnp.linspace(0.0, 1.0, SEARCH.windows + 1) * end
    return jax.lax.fori_loop(0, SEARCH.rounds, closer, best(grid, grid))[2]
