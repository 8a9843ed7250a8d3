from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recorded_impacts import two_impacts

from bayestissue.mechanics.elements import impact
from bayestissue.model.likelihood.impact import MeasuredImpact
from bayestissue.model.likelihood.response import motion

pytestmark = pytest.mark.slow


@jax.jit
def density(measured: MeasuredImpact) -> jax.Array:
    return measured.log_density()


def test_motion_is_the_simulated_one() -> None:
    wall = two_impacts("wall").measured
    record, names = wall.record, [each.name for each in wall.element.parameters]
    x, v, _ = jax.jit(lambda: motion(wall.collision, record))()
    values: dict[str, Any] = dict(zip(names, wall.parameters, strict=True))
    expected = impact("wall", values, record.mass, record.velocity, record.time())
    for own, other, atol in ((x, expected.x, 1e-8), (v, expected.v, 1e-6)):
        np.testing.assert_allclose(np.where(record.inside(), own - other, 0.0), 0.0, atol=atol)


def test_a_response_beyond_all_bounds_has_no_density() -> None:
    """A wall far thinner than the penetration: the solver's answer is beyond what products can hold."""
    wall = two_impacts("wall").measured
    found = density(replace(wall, parameters=wall.parameters.at[2].set(jnp.array([0.03, 1e-4]))))
    assert np.isfinite(found[0])
    assert found[1] == -np.inf
