"""Traces whose times are uneven."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recorded_impacts import two_impacts

from bayestissue.model.likelihood.impact import MeasuredImpact
from bayestissue.model.likelihood.record import Contact, UnevenTimes

pytestmark = pytest.mark.slow


@jax.jit
def log_density(measured: MeasuredImpact) -> jax.Array:
    return measured.log_density()


def test_even_times_give_the_density_of_even_times_for_contact_in_any_of_several_cells() -> None:
    """The cubic between states misses by (omega h)^4 / 384, 1e-7."""
    measured = two_impacts("kelvin_voigt").measured
    before = 0.5 * np.random.default_rng(4).standard_normal((2, 4))
    contact = Contact.anywhere(before, np.array([4, 3]), np.array([0.5, 0.6]))
    even = measured.record._replace(contact=contact)
    later, before_s = (even.dt[:, None] * jnp.arange(*which) for which in ((even.d.shape[1],), (-4, 0)))
    uneven = even._replace(uneven=UnevenTimes(later, before_s))
    found, expected = (log_density(replace(measured, record=one)) for one in (uneven, even))
    np.testing.assert_allclose(found, expected, atol=1e-4)
