"""Traces whose times are uneven: the motion and the density at the times that there are."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recorded_impacts import two_impacts

from bayestissue.mechanics.elements import impact
from bayestissue.model.likelihood.element.impact import MeasuredImpact
from bayestissue.model.likelihood.element.record import Contact, UnevenTimes
from bayestissue.model.likelihood.element.response import response

pytestmark = pytest.mark.slow


@jax.jit
def log_density(measured: MeasuredImpact) -> jax.Array:
    return measured.log_density()


@pytest.mark.parametrize("reach", [0, 4])
def test_even_times_give_the_density_of_even_times(reach: int) -> None:
    """For contact in any of several cells too; the cubic between states misses by (omega h)^4 / 384, 1e-7."""
    measured = two_impacts("kelvin_voigt").measured
    even = measured.record
    if reach:
        before = 0.5 * np.random.default_rng(4).standard_normal((2, reach))
        contact = Contact.anywhere(before, np.array([reach, reach - 1]), np.array([0.5, 0.6]))
        even = even._replace(contact=contact)
    before_s = (jnp.arange(reach) - reach) * even.dt[:, None]
    uneven = even._replace(uneven=UnevenTimes(jnp.arange(even.d.shape[1]) * even.dt[:, None], before_s))
    found, expected = (log_density(replace(measured, record=one)) for one in (uneven, even))
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("name", ["kelvin_voigt", pytest.param("stiffening", marks=pytest.mark.long)])
def test_the_response_is_the_element_s_at_these_times(name: str) -> None:
    measured = two_impacts(name, uneven=True).measured
    record = measured.record
    found = np.asarray(response(measured.element, measured.parameters, record).d)
    names = [each.name for each in measured.element.parameters]
    values = dict(zip(names, measured.parameters, strict=True))
    expected = np.array(impact(name, values, record.mass, record.velocity, record.time()).deceleration)
    assert np.abs(found - expected)[np.asarray(record.inside())].max() < 1e-6 * expected.max()
