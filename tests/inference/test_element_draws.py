from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from bayestissue.elements import element, impact
from bayestissue.elements.comparables import comparables
from bayestissue.inference.element_draws import secant_with
from bayestissue.likelihood.element_impact import MeasuredImpact
from bayestissue.likelihood.element_response import ElementRecord, motion

MASS, VELOCITY, DT = np.array([0.5, 1.2]), np.array([1.5, 1.0]), np.full(2, 2e-4)
FIRST = np.array([5e-5, 1.5e-4])
STIFF = {"K": 2000.0, "C": 20.0, "stiffening_depth_m": 0.02}
SIDE_BY_SIDE = {"K": 2600.0, "C": 25.0}
NONE = jnp.zeros(2)
# a goes to the peak along its slope a half sample before the last: up to two samples on, that leaves
# (2^2 / 2 + 2 / 2) (omega dt)^2 of it, with omega^2 = 1.06e4 / s^2 the greatest tangent stiffness over mass.
TOLERANCE = 3 * 1.06e4 * 2e-4**2


def measured(name: str, values: dict[str, float], to_peak: np.ndarray, off: int) -> MeasuredImpact:
    """A record whose window ends so many samples after the last before the greatest penetration."""
    count = np.floor((to_peak - FIRST) / DT).astype(int) + 1 + off
    still = np.zeros((2, count.max()))
    given = (FIRST, DT, VELOCITY, np.zeros((2, 4)), np.zeros(2, bool), MASS, np.full(2, 0.0318))
    parameters = jnp.array([np.full(2, value) for value in values.values()])
    return MeasuredImpact(element(name), parameters, NONE, ElementRecord.of(still, count, *given))


@pytest.mark.parametrize("off", [-1, 0, 1])
@pytest.mark.parametrize(("name", "values"), [("stiffening", STIFF), ("kelvin_voigt", SIDE_BY_SIDE)])
def test_without_a_discrepancy_the_secant_is_the_element_s(
    name: str, values: dict[str, float], off: int
) -> None:
    true = comparables(name, values, MASS, VELOCITY)
    given = measured(name, values, np.asarray(true.time_to_peak), off)
    found = secant_with(given, jnp.zeros_like(given.record.d), NONE)
    np.testing.assert_allclose(found, true.K_secant, rtol=TOLERANCE)


def test_the_secant_is_that_of_element_and_discrepancy_together() -> None:
    """What spring and damper lack of a stiffening element, given as discrepancy, makes up its secant."""
    true = comparables("stiffening", STIFF, MASS, VELOCITY)
    given = measured("kelvin_voigt", SIDE_BY_SIDE, np.asarray(true.time_to_peak), 0)
    own = motion(given.element, given.parameters, given.record, given.record.velocity)
    whole = impact("stiffening", STIFF, MASS, VELOCITY, given.record.time()).deceleration
    found = secant_with(given, whole - own.d, NONE)
    # Between contact and the first sample, of up to 80, delta is taken as constant; the rest is trapezia.
    np.testing.assert_allclose(found, true.K_secant, rtol=1e-3)
    assert (np.abs(SIDE_BY_SIDE["K"] / true.K_secant - 1) > 0.02).all()


def test_a_faster_impactor_goes_deeper() -> None:
    faster = comparables("stiffening", STIFF, MASS, VELOCITY + 0.05)
    given = measured("stiffening", STIFF, np.asarray(faster.time_to_peak), 0)
    found = secant_with(given, jnp.zeros_like(given.record.d), jnp.full(2, 0.05))
    np.testing.assert_allclose(found, faster.K_secant, rtol=TOLERANCE)
