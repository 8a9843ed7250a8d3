"""An error of the velocity in all impacts alike, where tissue moves along, against the integral over it."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_impact import record_of
from jax import Array
from jax.scipy.special import logsumexp

from bayestissue.mechanics.elements import element, impact
from bayestissue.model.likelihood.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.record import VELOCITY, DecelerationRecord

NUMBER, MASS, MOVES, V = 6, 0.5, 0.1, 1.5
K, C, RELATIVE_SD, SIGMA = 3000.0, 25.0, 0.2, 0.3
NONE = np.zeros(NUMBER)


def recorded() -> DecelerationRecord:
    """Impacts of one mass, faster than is said by one factor."""
    time = np.tile(5e-4 * np.arange(60), (NUMBER, 1)) + 2e-4
    parameters = {"K": K, "C": C, "moving_mass_kg": MOVES}
    made = impact("moving_mass", parameters, NONE + MASS, NONE + 1.1 * V, time)
    d = np.asarray(made.deceleration) + SIGMA * np.random.default_rng(1).standard_normal(time.shape)
    return record_of(d, time[:, 0], 5e-4, V, mass=MASS)


@jax.jit
def log_density(record: DecelerationRecord, moves: Array, faster: Array) -> Array:
    """Of all traces at so many times the recorded velocity, K and C over M + m as they are."""
    heavier = (MASS + moves) / (MASS + MOVES)
    parameters = jnp.outer(jnp.stack([K * heavier, C * heavier, moves]), jnp.ones(NUMBER))
    noise = NoiseParameters(jnp.log(SIGMA + NONE))
    record = record._replace(velocity=faster * record.velocity)
    return MeasuredImpact(element("moving_mass"), parameters, noise, record).log_density().sum()


@pytest.mark.slow
def test_many_impacts_tell_the_mass_that_moves_along_as_the_integral_over_one_error_does() -> None:
    record = recorded()
    wide = record.error_sd.at[:, VELOCITY].set(np.sqrt(NUMBER) * RELATIVE_SD * V)
    together = record._replace(error_sd=wide, shared_by=jnp.full(NUMBER, float(NUMBER)))
    moves = jnp.geomspace(0.02, 0.4, 5)
    shared = np.array([log_density(together, m, jnp.ones(())) for m in moves])
    exact = []
    for m in moves:
        # The errors that make the heights those that were recorded, and as many about them as count.
        faster = (MASS + m) / (MASS + MOVES) * 1.1 * (1 + jnp.linspace(-0.01, 0.01, 41))
        given = jax.lax.map(partial(log_density, record, m), faster)
        exact += [logsumexp(given - ((faster - 1) / RELATIVE_SD) ** 2 / 2, b=faster)]
    # What noise adds to the height of each is a thousandth of it.
    np.testing.assert_allclose(shared - shared[2], np.array(exact) - exact[2], atol=0.02)
