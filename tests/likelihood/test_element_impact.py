from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recorded_impacts import two_impacts

from bayestissue.mechanics.elements import impact
from bayestissue.model.likelihood.element.impact import MeasuredImpact, NoiseParameters
from bayestissue.model.likelihood.element.response import motion

pytestmark = pytest.mark.slow


@jax.jit
def density(measured: MeasuredImpact) -> jax.Array:
    return measured.log_density()


@pytest.mark.parametrize("gravity", [None, 9.80665])
def test_gain_and_velocity_of_kelvin_voigt_are_one_error(gravity: float | None) -> None:
    measured = two_impacts("kelvin_voigt", uniform=True, gravity=gravity).measured
    traces = measured.record
    if gravity:
        # Gain and velocity are then two errors.
        traces = traces._replace(error_sd=traces.error_sd.at[:, 1].set(0.0))
    velocity_sd, gain_sd, *others = traces.error_sd.T
    sd = jnp.stack([jnp.hypot(velocity_sd, gain_sd * traces.velocity), *others], axis=1)
    found, expected = (
        density(replace(measured, record=record)) for record in (traces, traces._replace(error_sd=sd))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_errors_of_the_chain_are_found_again() -> None:
    """Traces shifted by a velocity error and an offset, noise as small as makes both plain."""
    given = two_impacts("hunt_crossley").measured
    given = replace(given, noise_parameters=NoiseParameters(jnp.log(jnp.full(2, 1e-3))))
    sd = jnp.array([[0.02, 0.0, 0.5, 0.0], [0.02, 0.0, 0.5, 0.0]])
    found = jax.jit(given.response)()
    seen = found.d + 0.01 * found.by_velocity - 0.2
    made = given.record._replace(error_sd=sd, d=jnp.where(given.record.inside(), seen, 0.0))
    errors = jax.jit(replace(given, record=made).draw_errors)(jax.random.PRNGKey(1))
    # Noise of 1e-3 over some forty samples that change by about 100 and 1 per unit.
    np.testing.assert_allclose(errors[:, 0], 0.01, atol=1e-4)
    np.testing.assert_allclose(errors[:, 2], -0.2, atol=3e-3)


def test_motion_is_the_simulated_one() -> None:
    wall = two_impacts("wall").measured
    record, names = wall.record, [each.name for each in wall.element.parameters]
    found = jax.jit(lambda: motion(wall.element, wall.parameters, record, record.velocity))()
    values: dict[str, Any] = dict(zip(names, wall.parameters, strict=True))
    expected = impact("wall", values, record.mass, record.velocity, record.time())
    for own, other, atol in ((found.x, expected.x, 1e-8), (found.v, expected.v, 1e-6)):
        np.testing.assert_allclose(np.where(record.inside(), own - other, 0.0), 0.0, atol=atol)


def test_a_response_beyond_all_bounds_has_no_density() -> None:
    """A wall far thinner than the penetration: the solver's answer is beyond what products can hold."""
    wall = two_impacts("wall").measured
    found = density(replace(wall, parameters=wall.parameters.at[2].set(jnp.array([0.03, 1e-4]))))
    assert np.isfinite(found[0])
    assert found[1] == -np.inf
